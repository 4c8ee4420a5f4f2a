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
"""Sections of a campaign's report with its findings: reductions, statements and their evidence, uncertainty budget."""

from __future__ import annotations

from collections.abc import Iterator

from markupsafe import Markup

from impact_rig.analysis.uncertainty_budget import COVERAGE, budget
from impact_rig.config import Origin
from impact_rig.config.tree import Value
from impact_rig.physics.contact import from_config
from impact_rig.rig.config import RigConfig, fields, to_flat
from impact_rig.rig.gaps import NO_SPHERE
from impact_rig_studies.campaign.paper import CURRENT_A, FREQUENCY_HZ, REDUCTION_PERCENT
from impact_rig_studies.campaign.results import Point
from impact_rig_studies.campaign.run import Finished
from impact_rig_studies.campaign.statements import Variation
from impact_rig_studies.report.content import BUDGET_HEADINGS, Cell, Content, budget_rows, number, uncertain
from impact_rig_studies.report.dt import damper_effects
from impact_rig_studies.report.page import paragraph

BUDGETED_GAP_M = 6e-3  # the case whose uncertainty is analysed, if it was measured


def value_cell(value: Value) -> str | Cell:
    """Return a value of a configuration for a table: a cell for a number, a text for any other value."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)
    return number(float(value)) if isinstance(value, float) else Cell(str(value), value)


def reductions_table(done: Finished, content: Content) -> Iterator[Markup]:
    """Yield a table of DT and its reduction for each gap, with the paper's reductions, as HTML.

    Nothing is yielded if no reduction was measured.
    """
    reductions = done.reductions()
    ours, spread, errors = reductions.percent(), reductions.percent_uncertainty, reductions.errors()
    if not ours:
        return
    u = reductions.dt_uncertainty
    rows: list[list[str | Cell]] = [["none", uncertain(reductions.dt_no_sphere, u[NO_SPHERE]), "", "", ""]]
    rows += [
        [
            number(gap * 1e3, "g"),
            uncertain(reductions.dt[gap], u[gap]),
            number(REDUCTION_PERCENT[gap], ".1f"),
            uncertain(ours[gap], spread[gap]),
            Cell(f"{errors[gap]:+z.1f}", errors[gap]),
        ]
        for gap in sorted(ours)
    ]
    headings = ["gap (mm)", f"DT at {FREQUENCY_HZ:g} Hz", "paper (%)", "ours (%)", "difference"]
    yield content.table("reductions", headings, rows, range(5))
    largest = content.fact("max_abs_error_points", reductions.max_abs_error(), ".2f")
    rms = content.fact("rms_error_points", reductions.rms_error(), ".2f")
    yield paragraph(f"Largest difference {largest} points, rms {rms}. A fit, not a prediction: see below.", "muted")


def damper(done: Finished, content: Content) -> Iterator[Markup]:
    """Yield a table of the sphere's added mass (in percent of m_1) and loss factor (in percent) by gap, as HTML.

    Both follow from DT with and without the sphere, at the frequency with the most measured gaps. Nothing is yielded if
    DT was not measured with and without the sphere at the same frequency.
    """
    found = damper_effects(done.curves, done.calibration)
    counts = [frequency for own in found.values() for frequency in own]
    if not counts:
        return
    at_hz = max(counts, key=lambda frequency: (counts.count(frequency), -abs(frequency - FREQUENCY_HZ)))
    rows: list[list[str | Cell]] = [
        [
            number(gap * 1e3, "g"),
            uncertain(100.0 * one.added_mass, 100.0 * one.u_added_mass),
            uncertain(100.0 * one.loss_factor, 100.0 * one.u_loss_factor),
        ]
        for gap, own in found.items()
        if (one := own.get(at_hz)) is not None
    ]
    headings = ["gap (mm)", f"added mass at {at_hz:g} Hz (% of m_1)", "loss factor (%)"]
    yield content.table("damper", headings, rows, range(3))


def statements(done: Finished, content: Content) -> Iterator[Markup]:
    """Yield a table of the paper's statements with verdict, kind of evidence and margin, as HTML.

    Nothing is yielded if no statement was judged.
    """
    verdicts = done.verdicts()
    if all(verdict.result is None for verdict in verdicts):
        return
    yield paragraph(
        "Each verdict is computed from the points of this campaign. The evidence is stated next to it: a "
        "statement that other values of the chosen constants would break is a fit, one that repeats what was "
        "fitted follows from it, and only the rest are predictions. The margin is the distance of the figure "
        "from its limit. Limits introduced by us (“here”) are not the paper’s."
    )
    rows: list[list[str | Cell]] = []
    for i, one in enumerate(verdicts, 1):
        figures: list[str | Cell] = ["", "", "", ""]
        if one.result is not None and one.margin is not None:
            values = (number(one.result.value, ".4g"), number(one.result.limit, ".4g"), number(one.margin, ".3g"))
            figures = [*values, "" if one.unit == "-" else one.unit]
        rows.append([Cell(str(i), i), one.text, one.word, one.kind.value, one.detail, *figures])
    headings = ["no.", "statement", "verdict", "worth", "found", "value", "limit", "margin", "unit"]
    yield content.table("statements", headings, rows, [5, 6, 7])


def uncertainty(done: Finished, content: Content) -> Iterator[Markup]:
    """Yield the uncertainty budget of one DT at 9.1 Hz as HTML.

    The budget is for the gap of 6 mm, or without sphere if that gap was not measured. Nothing is yielded if neither was
    measured.
    """
    chosen: Point | None = None
    for gap in (BUDGETED_GAP_M, NO_SPHERE):
        chosen = chosen or done.curves.at(gap, FREQUENCY_HZ)
    if chosen is None:
        return
    found = budget(chosen.rows, done.calibration)
    name, frequency = content.fact("budget_case", chosen.label), content.fact("budget_hz", chosen.frequency_hz, "g")
    repetitions = content.fact("budget_measurements", len(chosen.rows))
    yield paragraph(
        f"DT of one case, {name} at {frequency} Hz; settled measurements: {repetitions}. Type A comes from the "
        "measurement itself, B from the certificate. The sensitivity of a sensor is taken at the amplitude of this "
        "case. It includes the error of the sensor's curve, so it differs from u(S) of the certificate, which is that "
        "of a small vibration. The errors of the sensitivities are the same in every DT of this report, so they cancel "
        "in reductions."
    )
    expanded = COVERAGE * found.u_transmissibility
    relative = found.u_transmissibility / found.transmissibility
    whole = [number(100.0 * COVERAGE * relative, ".2g"), number(expanded, ".2g")]
    rows = budget_rows(found)
    rows.append(["expanded", f"{COVERAGE:g} combined", "", *whole, ""])
    yield content.table("uncertainty_budget", BUDGET_HEADINGS, rows, [3, 4, 5])
    result = uncertain(found.transmissibility, found.u_transmissibility)
    yield content.table("uncertainty_result", ["result", "DT"], [[chosen.label, result]], [1])


def chosen(config: RigConfig, content: Content) -> Iterator[Markup]:
    """Yield a table of the rig's constants that were chosen to match the paper, with explanations, as HTML.

    The current is always in the table. `content` also stores the table and its numbers, for `report.json`.
    """
    values = to_flat(config)
    rows: list[list[str | Cell]] = [
        [name, value_cell(values[name]), about.unit, about.doc]
        for name, about, _ in fields()
        if about.origin is Origin.IDENTIFIED
    ]
    rows.append(["current", number(CURRENT_A), "A", "Constant coil current, peak."])
    yield paragraph(
        f"The paper prints neither amplitudes nor these {content.fact('constants_chosen', len(rows))} constants. They "
        "were chosen to match its five reductions, its natural frequency and its statements. The five reductions of "
        "this page are therefore a fit, not a validation. They determine only two combinations of the three constants "
        "m₁, ζ and current (docs/how-to/identification.md)."
    )
    yield content.table("chosen", ["constant", "value", "unit", "meaning"], rows, [1])
    yield paragraph(
        "Nothing else on this page was fitted: neither DT above resonance, nor regimes and impacts per cycle, nor the "
        "optimum gap, nor any gap wider than those of the paper."
    )
    law = from_config(config.contact)
    nominal = content.fact("restitution_nominal", law.restitution, "g")
    returned = content.fact("restitution_realised", law.realised_restitution(), ".3f")
    yield paragraph(
        f"The contact law {config.contact.law.replace('_', ' ')} with the nominal restitution {nominal} "
        f"returns {returned} in this simulation."
    )


def margins(varied: list[Variation], content: Content) -> Iterator[Markup]:
    """Yield a table of the verdicts on the paper's statements for rigs with varied constants, as HTML.

    A cell contains the value that decides a statement, and the verdict. It is empty if the statement was not judged.
    Nothing is yielded if `varied`, the verdicts for these rigs, is empty. `content` also stores the table, for
    `report.json`.
    """
    if not varied:
        return
    yield paragraph(
        "In each row, one constant differs from the rig of this page. The cells show the figure of each statement, and "
        "whether the statement still holds. An empty cell means that the statement was not judged."
    )
    judged = [verdict.result for verdict in varied[0].verdicts]
    rows: list[list[str | Cell]] = [["limit", *("" if one is None else number(one.limit, ".4g") for one in judged)]]
    for one in varied:
        values = {name: value_cell(value) for name, value in one.changed.items()}
        names = [f"{name} = {cell.text if isinstance(cell, Cell) else cell}" for name, cell in values.items()]
        cells = [
            "" if v.result is None else Cell(f"{v.result.value:.4g} {v.word}", v.result.value) for v in one.verdicts
        ]
        rows.append([", ".join(names) or "the rig itself", *cells])
    yield content.table("margins", ["rig", *(str(i) for i in range(1, len(judged) + 1))], rows)
