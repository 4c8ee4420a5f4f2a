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
"""Beginning of a campaign's report: title, origin and key results, then the drawn set-up and its instruments."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from impact_rig.arithmetic import ARITHMETIC
from impact_rig.drawing import GRID, INK, MEASURED, MUTED, QUIET, TRUTH, WIDTH_INCH, Drawn, new_axes
from impact_rig.errors import RecordingError
from impact_rig.physics.contact import from_config
from impact_rig.physics.linear import constants, hertz_stiffness_n_m32, sphere_mass_kg
from impact_rig_studies.campaign import paper, run
from impact_rig_studies.campaign.results import FILE_NAME as SUMMARY_FILE
from impact_rig_studies.campaign.run import Finished
from impact_rig_studies.campaign.tasks import CONFIGURATION_FILE
from impact_rig_studies.report.content import Cell, Content, number
from impact_rig_studies.report.page import cover, heading, paragraph, tiles, title

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DIGITS = 12  # number of characters of a digest


def opening(done: Finished, content: Content) -> Iterator[Markup]:
    """Yield the beginning of a campaign's report as HTML: title, origin of the results, key figures, explanation.

    The origin of the results states paper, configuration, seed, time and versions.
    """
    yield title(done.campaign.title)
    yield paragraph("Report of a measurement on the virtual test rig of an impact damper", "muted")
    yield cover(_entries(done, content))
    yield tiles(_key_figures(done, content))
    yield paragraph(
        "Every number here was measured through the simulated instruments and the analysis, as in a laboratory; a "
        f"number behind ± is {content.fact('coverage_factor', 2.0, 'g')} combined standard uncertainties. Where the "
        "true value of the virtual rig is shown, this is stated."
    )


def versions(done: Finished) -> dict[str, object]:
    """Return software versions, machine and way of measurement (`through`) of a campaign, from `provenance.json`.

    Raises:
        RecordingError: the file cannot be read.
    """
    try:
        return dict(json.loads((done.directory / run.PROVENANCE_FILE).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError, RecursionError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise RecordingError(
            f"{done.directory / run.PROVENANCE_FILE} cannot be read: {why}; repeat the command that began this "
            "campaign, which writes the file again and keeps the results"
        ) from error


def _entries(done: Finished, content: Content) -> list[tuple[str, str]]:
    base, with_ = done.campaign.base, versions(done)
    digest = hashlib.sha256((done.directory / CONFIGURATION_FILE).read_bytes()).hexdigest()[:DIGITS]
    law = base.contact.law.replace("_", " ")
    entries = [
        ("Paper", f"{paper.TITLE}. {paper.AUTHORS}, {paper.AFFILIATION}."),
        ("DOI", paper.DOI or "none found"),
        ("Configuration", f"contact law {law}, {base.daq.rate_hz} scans/s; {CONFIGURATION_FILE} sha256 {digest}…"),
        ("Seed", str(base.daq.seed)),
        ("Measured", written(done)),
        ("Version", str(with_.get("impact_rig", "not recorded"))),
        ("Arithmetic", f"version {with_.get('arithmetic', f'not recorded; this program has {ARITHMETIC}')}"),
    ]
    return [(what, content.fact(what.lower(), value)) for what, value in entries]


def written(done: Finished) -> str:
    """Return the time at which the results of a campaign were written, as in its `summary.json`; empty if unknown."""
    try:
        return str(json.loads((done.directory / SUMMARY_FILE).read_text(encoding="utf-8")).get("written", ""))
    except (OSError, ValueError, AttributeError, RecursionError):
        return ""


def _key_figures(done: Finished, content: Content) -> list[tuple[str, str]]:
    reductions, verdicts = done.reductions(), done.verdicts()
    judged = [verdict for verdict in verdicts if verdict.result is not None]
    held = sum(verdict.word == "pass" for verdict in judged)
    items = [
        (content.fact("points", len(done.points)), "points measured"),
        (content.fact("failed_points", len(done.failed())), "without a settled measurement"),
    ]
    if judged:
        held_text, of = content.fact("statements_held", held), content.fact("statements", len(verdicts))
        items.append((f"{held_text} of {of}", "statements of the paper hold"))
    if reductions.dt:
        frequency = content.fact("compared_at_hz", paper.FREQUENCY_HZ, "g")
        largest = content.fact("max_abs_error_points", reductions.max_abs_error(), ".2f")
        items += [
            (f"{largest} points", "largest difference from the paper's reductions"),
            (f"{content.fact('rms_error_points', reductions.rms_error(), '.2f')} points", "rms difference"),
            (content.fact("dt_no_sphere", reductions.dt_no_sphere, ".1f"), f"DT without sphere at {frequency} Hz"),
        ]
    return items


def apparatus(done: Finished, content: Content) -> Iterator[Markup]:
    """Yield the section about the rig as HTML: the drawn set-up, its constants, and the calibrated instruments."""
    yield content.figures([set_up()])
    yield heading("Constants of the rig")
    yield content.table("constants", ["symbol", "value", "unit", "meaning"], _constants(done), [1])
    yield heading("Instruments and their calibration")
    yield paragraph(
        "The calibration certificate of this rig and seed. The analysis knows nothing else about the instruments."
    )
    yield from instruments_table(done.info, content)


def instruments_table(info: NDArray[np.void], content: Content) -> Iterator[Markup]:
    """Yield an explanation and a table of the instruments in rows of `daq/info`, as HTML."""
    yield paragraph(
        "u(S): relative standard uncertainty of the sensitivity for a small vibration; noise: rms; read after: "
        "conversion after the scan clock."
    )
    headings = [
        "instrument", "range", "sensitivity", "u(S) (%)", "noise", "resolution", "bandwidth", "lag", "read after",
    ]  # fmt: skip
    yield content.table("instruments", headings, _instruments(info), range(1, len(headings)))


def _constants(done: Finished) -> list[list[str | Cell]]:
    base = done.campaign.base
    c, law = constants(base), from_config(base.contact)
    values: list[tuple[str, float, str, str]] = [
        ("m₁", c.m_1, "kg", "superior base with barriers"),
        ("k₁", c.k_1, "N/m", "columns, stiffness"),
        ("c₁", c.c_1, "N s/m", "columns, damping"),
        ("f_n", base.structure.natural_frequency_hz, "Hz", "natural frequency of the superior base on its columns"),
        ("ζ", base.structure.damping_ratio, "-", "damping ratio"),
        ("m_a + m_b", c.m_base, "kg", "moving element and inferior base"),
        ("k_f", c.k_f, "N/m", "shaker, suspension"),
        ("c_f", c.c_f, "N s/m", "shaker, damping"),
        ("K_f", c.force_factor, "N/A", "shaker, force per current"),
        ("m", sphere_mass_kg(base.sphere), "kg", "sphere"),
        ("K", hertz_stiffness_n_m32(base.sphere, base.barriers), "N/m^1.5", "contact stiffness"),
        ("e", law.restitution, "-", "restitution, nominal"),
        ("e realised", law.realised_restitution(), "-", f"restitution that the contact law {base.contact.law} gives"),
        ("I", paper.CURRENT_A, "A", "coil current of the paper's cases, peak"),
    ]
    return [[symbol, number(value, ".5g"), unit, meaning] for symbol, value, unit, meaning in values]


def _instruments(info: NDArray[np.void]) -> list[list[str | Cell]]:
    rows: list[list[str | Cell]] = []
    for row in info:
        unit = row["unit"].decode()
        small, factor = (("µm", 1e6), ("mm", 1e3)) if unit == "m" else ((unit, 1.0), (unit, 1.0))
        rows.append(
            [
                row["name"].decode(),
                _range(float(row["range_low"]) * factor[1], float(row["range_high"]) * factor[1], factor[0]),
                _with_unit(float(row["sensitivity"]) / factor[1], f"V/{factor[0]}"),
                number(100.0 * float(row["sensitivity_uncertainty"]), ".2g"),
                _with_unit(float(row["noise"]) * small[1], small[0]),
                _with_unit(float(row["resolution"]) * small[1], small[0]),
                _with_unit(float(row["bandwidth"]), "Hz") if row["bandwidth"] else Cell("unknown", None),
                _with_unit(1e3 * float(row["lag"]), "ms"),
                _with_unit(1e6 * float(row["skew"]), "µs"),
            ]
        )
    return rows


def _range(low: float, high: float, unit: str) -> Cell:
    if not (math.isfinite(low) and math.isfinite(high)):
        return Cell("unlimited", None)
    return Cell(f"{_short(low)} to {_short(high)} {unit}", (low, high))


def _with_unit(value: float, unit: str) -> Cell:
    return Cell(f"{_short(value)} {unit}", value) if math.isfinite(value) else Cell("unlimited", None)


def _short(value: float) -> str:
    """Return a number with three significant digits as text; very large and very small ones have an exponent."""
    return f"{float(f'{value:.3g}'):g}"


# --- The set-up, drawn: shaker, bases, columns, barriers and sphere, their symbols, and where the instruments look

WIDTH, HEIGHT = 100.0, 76.0  # of the drawing, in its own units: hundredths of its width
SYMBOL = 9.5  # type size of symbols


def set_up() -> Drawn:
    """Draw a diagram of the rig with its symbols and instruments; call this within `drawing.style`."""
    figure, (axis,) = new_axes(WIDTH_INCH * HEIGHT / WIDTH)
    axis.set(xlim=(0.0, WIDTH), ylim=(0.0, HEIGHT), aspect="equal")
    axis.axis("off")
    _machine(axis)
    _damper(axis)
    _draw_instruments(axis)
    _symbols(axis)
    caption = (
        "The set-up. A shaker moves the inferior base; elastic columns carry the superior base and its two barriers, "
        "between which the loose sphere moves. Blue: the instruments, in the order in which one converter reads them."
    )
    return Drawn("set_up", figure, caption)


def _box(axis: Axes, x: float, y: float, width: float, height: float, *, edge: str = INK, fill: str = QUIET) -> None:
    from matplotlib.patches import Rectangle  # noqa: PLC0415  # heavy: only when something is drawn

    axis.add_patch(Rectangle((x, y), width, height, edgecolor=edge, facecolor=fill, linewidth=1.0))


def _arrow(
    axis: Axes, start: tuple[float, float], end: tuple[float, float], kind: str = "->", shade: str = INK
) -> None:
    arrow = {"arrowstyle": kind, "color": shade, "linewidth": 0.9, "shrinkA": 0.0, "shrinkB": 0.0}
    axis.annotate("", xy=end, xytext=start, arrowprops=arrow)


def _machine(axis: Axes) -> None:
    from matplotlib.patches import Circle  # noqa: PLC0415  # as above

    axis.plot([0.0, WIDTH], [5.0, 5.0], color=MUTED, linewidth=1.0)
    _box(axis, 2.0, 5.0, 17.0, 17.0)
    axis.text(10.5, 13.5, "shaker", ha="center", va="center")
    axis.plot([19.0, 27.0], [13.5, 13.5], color=INK, linewidth=2.4)
    _box(axis, 27.0, 9.0, 44.0, 9.0)
    axis.text(49.0, 13.5, "inferior base", ha="center", va="center")
    for x in (34.0, 64.0):
        axis.add_patch(Circle((x, 7.0), 1.9, edgecolor=INK, facecolor=GRID, linewidth=0.8))
        axis.plot([x, x], [18.0, 46.0], color=INK, linewidth=2.0)
    _box(axis, 27.0, 46.0, 44.0, 8.0)
    axis.text(49.0, 50.0, "superior base", ha="center", va="center")


def _damper(axis: Axes) -> None:
    from matplotlib.patches import Circle  # noqa: PLC0415  # as above

    for x in (29.0, 65.0):
        _box(axis, x, 54.0, 4.0, 11.0, fill=GRID)
    axis.add_patch(Circle((49.0, 57.2), 3.2, edgecolor=TRUTH, facecolor=QUIET, linewidth=1.4))
    for wall, side in ((33.0, 45.8), (65.0, 52.2)):
        _arrow(axis, (wall, 57.2), (side, 57.2), "<->", MUTED)
        axis.text((wall + side) / 2.0, 58.2, "$g/2$", ha="center", va="bottom", fontsize=SYMBOL)


def _draw_instruments(axis: Axes) -> None:
    for x, y, width, height in ((21.5, 47.5, 5.5, 5.0), (88.0, 46.5, 10.0, 7.0), (82.0, 10.5, 10.0, 6.0)):
        _box(axis, x, y, width, height, edge=MEASURED)
    axis.plot([71.0, 88.0], [50.0, 50.0], color=MEASURED, linewidth=1.0, linestyle=":")
    axis.plot([71.0, 82.0], [13.5, 13.5], color=MEASURED, linewidth=1.0, linestyle=":")
    axis.plot([10.5, 10.5], [22.0, 27.0], color=MEASURED, linewidth=1.0)
    for x, y, text, side in (
        (20.0, 50.0, "1 accelero-\nmeter", "right"),
        (93.0, 41.8, "2 laser", "center"),
        (87.0, 20.5, "3 base sensor", "center"),
        (10.5, 29.5, "4 coil current", "center"),
    ):
        axis.text(x, y, text, ha=side, va="center", color=MEASURED, fontsize=8.5)


def _symbols(axis: Axes) -> None:
    places: Sequence[tuple[float, float, str]] = (
        (10.5, 2.0, "$K_f,\\ k_f,\\ c_f$"),
        (49.0, 2.0, "$m_a + m_b$"),
        (49.0, 32.0, "$k_1,\\ c_1$"),
        (75.5, 57.5, "$m_1$"),
        (49.0, 66.5, "$m$"),
    )
    for x, y, text in places:
        axis.text(x, y, text, ha="center", va="center", fontsize=SYMBOL)
    for start, text in (((71.0, 26.0), "$x_b$"), ((71.0, 64.5), "$x_1$"), ((49.0, 71.0), "$x_2$")):
        _arrow(axis, start, (start[0] + 9.0, start[1]))
        axis.text(start[0] + 10.5, start[1], text, ha="left", va="center", fontsize=SYMBOL)
