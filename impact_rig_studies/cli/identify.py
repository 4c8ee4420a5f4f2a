# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Command `impact-rig identify`: constants of the rig from measured runs, or from the paper's numbers."""

from __future__ import annotations

import argparse
import json
import math

import numpy as np

from impact_rig.analysis.uncertainty_budget import plus_minus, rounded
from impact_rig.cli.terminal import Console, TextTable, figure, tell_json, tell_program
from impact_rig.errors import ConfigError, ImpactRigError
from impact_rig.recording import open_run
from impact_rig.rig.config import RigConfig, dump, load_config
from impact_rig.rig.gaps import NO_SPHERE
from impact_rig.states import Status
from impact_rig.system import files
from impact_rig_studies.campaign import run
from impact_rig_studies.campaign.paper import CURRENT_A, FREQUENCIES_HZ, FREQUENCY_HZ, REDUCTION_PERCENT
from impact_rig_studies.decay import REASONS, fit_decay, log_decrement
from impact_rig_studies.identification import U_RESTITUTION, paper_fit
from impact_rig_studies.identification.fit import (
    NAMES,
    SCALED,
    START,
    UNITS,
    Identified,
    Information,
    identify,
    logarithms,
)
from impact_rig_studies.identification.measurements import (
    Gains,
    Measured,
    measured_decay,
    recorded_decay,
    reduced_of,
    sine_of,
)

JSON_FILE, CONFIGURATION_FILE = "identification.json", "identified.yaml"


def run_identify(arguments: argparse.Namespace) -> int:
    """Fit constants to a campaign or to the paper's reductions of DT, print them, and return the exit code, 0.

    The constants of a campaign are written into its directory. A configuration with these constants is written only if
    the data determine all of them and the model explains the data. Otherwise the configuration of an earlier fit is
    removed. For the paper's reductions, nothing is written.
    """
    console = Console(quiet=arguments.json)
    _check_combination(arguments)
    if arguments.paper:
        base = load_config(arguments.config) if arguments.config else RigConfig()
        fits = []
        for free in (("f_n", "ζ"), ("f_n", "ζ", "I")):
            fits.append(paper_fit.fit_paper(base, free, lambda what: console.print(f"{what} ...")))
            _print_paper(console, fits[-1], base)
        if arguments.json:
            tell_json([_paper_content(fit) for fit in fits])
        return 0
    if not 0.0 <= arguments.e_uncertainty <= 1.0:
        raise ConfigError(f"--e-uncertainty must be >= 0 and <= 1, got {arguments.e_uncertainty!r}")
    done = run.open_finished(arguments.directory)
    measured = _measured(done, arguments, console)
    base = done.campaign.base
    start = logarithms(base) if done.imported else START
    found = identify(measured, base, start, lambda what: console.print(f"{what} ..."))
    print_identified(console, found)
    why = "the constants do not explain the data" if not found.consistent else ""
    if not why and not all(map(found.information.determined, NAMES)):
        why = "the data do not determine all constants"
    configuration = arguments.directory / CONFIGURATION_FILE
    if why:
        earlier = "; that of an earlier fit is removed" if configuration.exists() else ""
        console.print(f"no {CONFIGURATION_FILE} is written, because {why}{earlier}", style="red")
    content = identified_content(found)
    text = json.dumps(content, indent=2, ensure_ascii=False)
    configuration.unlink(missing_ok=True)  # first, so that an interruption does not leave results of two fits
    files.write_text(arguments.directory / JSON_FILE, f"{text}\n")
    if not why:
        files.write_text(configuration, dump(found.config))
    if arguments.json:
        tell_json(content)
    else:
        tell_program(arguments.directory.resolve())
    return 0


def _check_combination(arguments: argparse.Namespace) -> None:
    """Check that the options of the command can be combined; raise ConfigError if not.

    Either a campaign or `--paper` is needed, without options of the other fit. `--rig` needs `--decay`.
    """
    if arguments.paper and arguments.directory is not None:
        raise ConfigError(
            f"--paper fits the paper's reductions of DT and takes no directory: omit {arguments.directory}"
        )
    if not arguments.paper and arguments.directory is None:
        raise ConfigError(
            "the directory of a campaign is needed, e.g. runs/campaign_paper, or --paper to fit the paper's reductions"
        )
    of_campaign = {
        "--decay": arguments.decay,
        "--rig": arguments.rig,
        "--decrement": arguments.decrement,
        "--without": arguments.without,
        "--e-uncertainty": arguments.e_uncertainty != U_RESTITUTION,
    }
    if option := next((name for name, value in of_campaign.items() if value and arguments.paper), ""):
        raise ConfigError(
            f"{option} applies only to a campaign, not to the fit of the paper's reductions (--paper): omit one of them"
        )
    if arguments.config and not arguments.paper:
        raise ConfigError("--config applies only to --paper, as a fitted campaign has its own configuration: omit it")
    if arguments.rig and not arguments.decay:
        raise ConfigError("--rig applies only to the run of --decay: omit it, or add --decay RUN")
    of_decay = {"--decay": arguments.decay, "--decrement": arguments.decrement}
    if (option := next((name for name, value in of_decay.items() if value), "")) and "decay" in arguments.without:
        raise ConfigError(f"{option} applies to the free decay, which --without decay leaves out: omit one of them")


def _measured(done: run.Finished, arguments: argparse.Namespace, console: Console) -> Measured:
    """Collect the data for a fit (free decay, stepped sine and reductions), and print a summary of them.

    The free decay is that of the run of `--decay`, or simulated unless the campaign was imported. The other data are
    points of the campaign. Data that are missing, or named in `--without`, are None. If the free decay cannot be
    measured, ImpactRigError is raised.
    """
    base, curves = done.campaign.base, done.curves
    gains = Gains.of(done.info)
    decay = sine = reduced = None
    method = log_decrement if arguments.decrement else fit_decay
    if "decay" not in arguments.without:
        if arguments.decay is None:
            if arguments.decrement and done.imported:
                raise ConfigError(
                    f"{arguments.directory} is an imported campaign, which has no free decay: add --decay RUN, or omit "
                    "--decrement"
                )
            decay = None if done.imported else measured_decay(base, method)
        else:
            with open_run(arguments.decay, arguments.rig) as recorded:
                decay = recorded_decay(recorded, method)
    if decay is not None:
        if decay.status is not Status.OK:
            why = REASONS.get(decay.status, f"{decay.status.value} ({decay.status.doc.rstrip('.')})")
            whose = f"of {arguments.decay}" if arguments.decay else "simulated for this campaign"
            raise ImpactRigError(f"the free decay {whose} cannot be measured: {why}; leave it out with --without decay")
        console.print(
            f"free decay: f_n {plus_minus(decay.natural_frequency_hz, decay.u_natural_frequency_hz)} Hz, "
            f"ζ {plus_minus(decay.damping_ratio, decay.u_damping_ratio)} (2u)"
        )
    if "sine" not in arguments.without:
        frequencies = curves.frequencies(NO_SPHERE) if done.imported else FREQUENCIES_HZ
        points = [point for f in frequencies if (point := curves.at(NO_SPHERE, f)) is not None]
        sine = sine_of(points, gains) if points else None
        console.print(f"stepped sine without sphere: {len(points)} points of the campaign are used")
    if "reductions" not in arguments.without:
        at_hz, gaps = FREQUENCY_HZ, tuple(REDUCTION_PERCENT)
        if done.imported:  # at the frequency with the most gaps besides the curve without sphere
            gaps = tuple(curves.gaps())
            counts = {f: sum(curves.at(g, f) is not None for g in gaps) for f in curves.frequencies(NO_SPHERE)}
            at_hz = max(counts, key=lambda f: counts[f], default=FREQUENCY_HZ)
        reduced = reduced_of(curves, at_hz, gaps, gains)
        console.print(f"reductions at {at_hz:g} Hz: {len(reduced.ratio) if reduced else 0} gaps are used")
    return Measured(gains=gains, decay=decay, sine=sine, reduced=reduced, u_restitution=arguments.e_uncertainty)


def print_identified(console: Console, found: Identified) -> None:
    """Print the identified constants with their uncertainties, and warn if the model does not explain the data."""
    table = TextTable("Constants of the rig", left=("constant",), right=("value", "± 2u"), last=("unit", ""))
    for name, unit in zip(NAMES, UNITS, strict=True):
        if found.information.determined(name):
            table.add_row(name, *rounded(found.value(name), found.u(name)), unit, "")
        else:
            table.add_row(name, "-", "-", unit, "not determined by these data", style="bright_black")
    if math.isfinite(found.restitution):
        table.add_row("e", *rounded(found.restitution, found.u_restitution), "-", "nominal")
    console.print(table)
    for gap, u in found.irregular.items():
        console.print(
            f"at a gap of {gap * 1e3:g} mm the motion of the fitted rig is not periodic: its mean DT is used, with a "
            f"relative standard uncertainty of {100 * u:.2g} %"
        )
    _print_alternatives(console, found)
    console.print(
        f"χ² {found.chi_square:.1f} for {found.freedom} degrees of freedom: a fit as bad or worse occurs by chance in "
        f"{100 * found.chance:.1f} % of cases"
    )
    if not found.consistent:
        why = "χ² is too large" if found.converged else "the fit has not converged"
        if found.converged and found.contradicted:
            where = " and ".join(f"{gap * 1e3:g} mm" for gap in found.contradicted)
            why = f"at a gap of {where} the measured motion is periodic, and that of the fitted rig is not"
        console.print(
            f"WARNING: the model does not explain the data ({why}), so the uncertainties above are invalid. Something "
            "taken as known is wrong (contact law, e and its uncertainty, sphere, gaps), or a sensor is outside its "
            "certificate",
            style="red",
        )
    _print_combinations(console, found.information)


def _print_alternatives(console: Console, found: Identified) -> None:
    if not found.ambiguous:
        return
    console.print(
        "AMBIGUOUS: the data have several explanations, and the uncertainties above include all of them. A drop test "
        "(e), or one more gap, decides between them",
        style="yellow",
    )
    table = TextTable("Explanations", left=("probability",), right=("e", *SCALED))
    for one in found.alternatives:
        cells = [plus_minus(one.restitution, one.u_restitution)]
        for name in SCALED:
            value, u = (float(column[NAMES.index(name)]) for column in (np.exp(one.log_constants), one.u_relative))
            cells.append(plus_minus(value, u * value))
        table.add_row(f"{100 * one.share:.0f} %", *cells)
    console.print(table)


def _print_combinations(console: Console, information: Information) -> None:
    table = TextTable("Independent combinations, best known first", left=("product of powers", "relative u"))
    for one in information.combinations:
        known = f"{100 * one.u_relative:.2g} %" if one.determined else "not determined"
        table.add_row(one.text, known, style=None if one.determined else "bright_black")
    console.print(table)


def _print_paper(console: Console, fit: paper_fit.PaperFit, base: RigConfig) -> None:
    shipped = {"f_n": base.structure.natural_frequency_hz, "ζ": base.structure.damping_ratio, "I": CURRENT_A}
    title = f"{', '.join(fit.fitted)} fitted to the paper's reductions"
    table = TextTable(title, right=("", "fit", "± u", "in the configuration"))
    for name, value in fit.fitted.items():
        table.add_row(name, f"{value:.5g}", figure(fit.u[name], ".2g"), f"{shipped[name]:.5g}")
    console.print(table)
    reductions = ", ".join(f"{value:z.1f}" for value in fit.points.values())
    rest = "" if fit.converged else "; the fit has not converged, along a valley without a minimum"
    console.print(
        f"reductions of the fit {reductions} %; rms difference from the paper: {fit.rms_points:.2f} percentage points "
        f"with the fit, {fit.default_rms_points:.2f} with the configuration{rest}"
    )
    if "I" in fit.fitted:
        _print_combinations(console, fit.information)


def _paper_content(fit: paper_fit.PaperFit) -> dict[str, object]:
    return {
        "fitted": dict(fit.fitted),
        "u": dict(fit.u),
        "reductions_percent": {f"{gap * 1e3:g}": value for gap, value in fit.points.items()},
        "rms_points": fit.rms_points,
        "rms_points_of_the_configuration": fit.default_rms_points,
        "converged": fit.converged,
    }


def identified_content(found: Identified) -> dict[str, object]:
    """Return the identified constants as data for JSON, with their combinations and alternatives.

    A combination is a product of powers of the constants, with its own uncertainty. An alternative is another
    explanation of the same data, with its probability.
    """
    information = found.information
    return {
        "constants": {
            name: {
                "value": found.value(name) if information.determined(name) else None,
                "standard_uncertainty": found.u(name) if information.determined(name) else None,
                "unit": unit,
                "determined": information.determined(name),
            }
            for name, unit in zip(NAMES, UNITS, strict=True)
        },
        "combinations": [
            {
                "powers": dict(zip(NAMES, one.powers.tolist(), strict=True)),
                "relative_uncertainty": one.u_relative if one.determined else None,
            }
            for one in information.combinations
        ],
        "restitution": found.restitution if math.isfinite(found.restitution) else None,
        "restitution_standard_uncertainty": found.u_restitution if math.isfinite(found.u_restitution) else None,
        "irregular_mm": {f"{gap * 1e3:g}": u for gap, u in found.irregular.items()},
        "ambiguous": found.ambiguous,
        "alternatives": [
            {
                "probability": one.share,
                "restitution": one.restitution,
                "restitution_standard_uncertainty": one.u_restitution,
                "constants": dict(zip(NAMES, np.exp(one.log_constants).tolist(), strict=True)),
                "relative_uncertainties": dict(zip(NAMES, one.u_relative.tolist(), strict=True)),
            }
            for one in found.alternatives
        ],
        "chi_square": found.chi_square,
        "degrees_of_freedom": found.freedom,
        "chance": found.chance,
        "converged": found.converged,
        "consistent": found.consistent,
    }
