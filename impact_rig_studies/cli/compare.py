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
"""Command `impact-rig compare`: comparison of a measured run with the model that has the same drive."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING

import numpy as np

from impact_rig.analysis.uncertainty_budget import rounded
from impact_rig.cli.terminal import Console, TextTable, figure, tell_json
from impact_rig.recording import open_run
from impact_rig.system import files

if TYPE_CHECKING:
    from impact_rig_studies.comparison import Comparison

FAR_OFF = 2.0  # difference, in standard uncertainties, above which a row is marked as "differs"


def run_compare(arguments: argparse.Namespace) -> int:
    """Compare a recorded or imported run with the model, print the result, and return the exit code, 0.

    With `--figures`, the result is also drawn.
    """
    from impact_rig.rig.config import load_config  # noqa: PLC0415  # heavy: after the signals are taken
    from impact_rig_studies.comparison import compare, drawn  # noqa: PLC0415  # as above

    console = Console(quiet=arguments.json)
    if arguments.figures:
        files.make_folder(arguments.figures)
    known = load_config(arguments.config) if arguments.config else None
    with open_run(arguments.path, arguments.rig) as run:
        found = compare(
            run, known, arguments.drive, fits=not arguments.no_fit, on_step=lambda what: console.print(f"{what} ...")
        )
    if arguments.figures:
        drawn(found, arguments.path.name).save(arguments.figures, arguments.formats)
    _print(console, found)
    if arguments.json:
        tell_json(_content(found))
    return 0


def _content(found: Comparison) -> dict[str, object]:
    from impact_rig_studies.cli.identify import identified_content  # noqa: PLC0415  # as above

    residual = found.residual
    motion = found.excerpt.rows["laser"]
    return {
        "driven_by": found.driven_by,
        "places": [
            {
                "gap_mm": 1e3 * one.gap_m,
                "frequency_hz": one.frequency_hz,
                **{
                    f"{side}_{name}": None if row is None else row[name]
                    for name in ("transmissibility", "transmissibility_uncertainty", "phase", "phase_uncertainty")
                    for side, row in (("measured", one.measured), ("model", one.model))
                },
                "transmissibility_off_u": one.off("transmissibility"),
                "phase_off_u": one.off("phase"),
            }
            for one in found.places
        ],
        "traces": {
            "from_s": found.excerpt.rows["time"][0],
            "to_s": found.excerpt.rows["time"][-1],
            "structure_rms_m": np.std(motion),
            "residual_rms_m": np.std(residual),
        },
        "missing_for_constants": list(found.missing),
        **(identified_content(found.constants) if found.constants is not None else {}),
    }


def _print(console: Console, found: Comparison) -> None:
    from impact_rig_studies.cli.identify import print_identified  # noqa: PLC0415  # as above

    table = TextTable(
        f"Measured, and the model driven by the measured {found.driven_by}",
        right=("gap [mm]", "frequency [Hz]", "DT measured", "± 2u", "DT model", "off [u]", "phase off [u]"),
        last=("",),
    )
    for one in found.places:
        dt, phase = one.off("transmissibility"), one.off("phase")
        row = one.measured
        gap = "?" if math.isnan(one.gap_m) else f"{1e3 * one.gap_m:g}" if one.gap_m else "no sphere"
        cells = [gap, f"{one.frequency_hz:g}"]
        cells += rounded(row["transmissibility"], row["transmissibility_uncertainty"])
        if one.model is None:
            table.add_row(*cells, "-", "-", "-", "the model did not settle", style="yellow")
        else:
            far = max(abs(dt), abs(phase)) > FAR_OFF
            cells += [figure(one.model["transmissibility"], ".5g"), figure(dt, "+.1f"), figure(phase, "+.1f")]
            table.add_row(*cells, "differs" if far else "", style="yellow" if far else None)
    console.print(table)
    motion, residual = (float(np.std(one)) for one in (found.excerpt.rows["laser"], found.residual))
    if motion > 0.0:
        share = f"{100.0 * residual / motion:.3g} % of the structure's motion"
        console.print(f"{found.excerpt}: rms of the measured motion minus the model's: {share}")
    else:
        console.print(
            f"{found.excerpt}: the structure did not move; rms of the measured motion minus the model's: "
            f"{residual:.3g} m"
        )
    if found.constants is not None:
        print_identified(console, found.constants)
    elif found.missing:
        console.print(f"constants: none can be determined, because this run lacks {' and '.join(found.missing)}")
