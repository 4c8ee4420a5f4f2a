"""Figures of one recorded run: its curves, and traces, phase plane and spectrum of its last settled measurement."""

from __future__ import annotations

import math
import tempfile
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.analysis import figures
from impact_rig.analysis.tracker import Findings
from impact_rig.blocks import Table
from impact_rig.errors import RecordingError
from impact_rig.instruments.scan import SCAN
from impact_rig.recording import Run
from impact_rig.runs import reanalysis
from impact_rig.simtime import NS_PER_S
from impact_rig.system import files

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = ("png", "svg")
NAMES = ("time_traces", "phase_plane", "spectrum", "curves")
UNSETTLED_S = 5.0
"""Length of what is drawn of a run in which nothing settled."""
TRACED_CYCLES = 8
SMOOTHED_CYCLE = 40.0
"""The velocity of the phase plane is smoothed over this part of a cycle."""
HARMONICS = 10.5
UNDRIVEN_HZ = 100.0
"""The spectrum ends after so many harmonics of the drive, or here where none is known."""
HELD_S = 0.5
"""A measurement is reported at most this long after its last scan."""
FEWEST_SCANS = 100


@attrs.frozen(eq=False)
class Stretch:
    """Contiguous scans that are drawn.

    Attributes:
        rows: scans (`blocks.SCAN`), `time` [s since the first scan of the run], shape (n,).
        rate_hz: scans per second.
        drive_hz: drive frequency, 0 if unknown.
        impact_times: of the impacts detected in it [s as the rows' time], shape (k,).
        settled: whether it is a settled measurement; the end of the run otherwise.
    """

    rows: NDArray[np.void]
    rate_hz: float
    drive_hz: float
    impact_times: NDArray[np.float64]
    settled: bool

    def newest(self, cycles: int) -> Stretch:
        """Return the last cycles of the drive; everything where there is none."""
        scans = round(cycles / self.drive_hz * self.rate_hz) if self.drive_hz else len(self.rows)
        rows = self.rows[-scans:]
        return attrs.evolve(self, rows=rows, impact_times=self.impact_times[self.impact_times >= rows["time"][0]])

    def __str__(self) -> str:
        """Return for people which scans these are."""
        where = "of the last settled measurement" if self.settled else "of the end of the run; nothing settled"
        return f"{self.rows['time'][0]:.2f} s to {self.rows['time'][-1]:.2f} s, {where}"


def prepare(directory: Path, suffix: str) -> None:
    """Make the directory of the figures, so that a long analysis does not end in an error that could be foreseen.

    Raises:
        RecordingError: it cannot be made or written to, or there are figures in it already.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            pass
    except OSError as error:
        raise RecordingError(f"figures cannot be written to {directory}: {error.strerror}") from error
    there = [name for name in NAMES if (directory / f"{name}.{suffix}").exists()]
    if there:
        raise RecordingError(f"{directory / there[0]}.{suffix} exists already and is not overwritten")


def draw(run: Run, found: Sequence[Findings], directory: Path, suffix: str = "png") -> tuple[Stretch, list[Path]]:
    """Draw a run and return what was drawn, and the files written to `directory`.

    Args:
        run: an open run.
        found: everything that `reanalysis.analyze` found in it.
        directory: made by `prepare`.
        suffix: one of `FORMATS`.

    Raises:
        RecordingError: too few scans, or a file cannot be written.
    """
    name = run.path.name.replace("$", r"\$")  # would begin a formula
    stretch = last_stretch(run, found)
    traced = stretch.newest(TRACED_CYCLES)
    drawn = {
        "time_traces": figures.time_traces(traced.rows, traced.impact_times),
        "phase_plane": figures.phase_plane(
            stretch.rows["laser"], stretch.rate_hz, 1.0 / (SMOOTHED_CYCLE * stretch.drive_hz or math.inf)
        ),
        "spectrum": figures.spectrum(
            1e3 * stretch.rows["laser"], stretch.rate_hz, "mm", stretch.drive_hz,
            min(HARMONICS * stretch.drive_hz or UNDRIVEN_HZ, stretch.rate_hz / 2.0),
        ),
    }  # fmt: skip
    for figure, what in (
        ("time_traces", f"{traced}\nred: impacts found in the acceleration"),
        ("phase_plane", f"phase plane, {stretch}"),
        ("spectrum", f"spectrum of $x_1$, {stretch}"),
    ):
        drawn[figure].suptitle(f"{name}: {what}", fontsize="medium")
    curves = measured_curves(reanalysis.rows(reanalysis.measurements(iter(found))))
    if curves:
        drawn["curves"] = figures.transmissibility_curves(curves)
        drawn["curves"].suptitle(f"{name}: settled measurements, ±2u", fontsize="medium")
    return stretch, [_save(figure, directory / f"{stem}.{suffix}") for stem, figure in drawn.items()]


def last_stretch(run: Run, found: Sequence[Findings]) -> Stretch:
    """Return the scans of the last settled measurement, or the last `UNSETTLED_S` of the run.

    Raises:
        RecordingError: too few contiguous scans.
    """
    settled = [
        (number, table)
        for number, one in enumerate(found)
        for table in one.measurements
        if table.rows["settled"][0] == 1.0
    ]
    rate_hz = float([table.rows["rate"][0] for table in run.tables(topics.INFO.name)][-1])
    if settled:
        last, measured = settled[-1][0], settled[-1][1]
        drive_hz, end_ns = float(measured.rows["frequency"][0]), measured.stamp_ns
        span_s = float(measured.rows["cycles"][0]) / drive_hz
    else:
        drive = [table.rows["frequency"][-1] for table in run.tables(topics.APPLIED.name, recorded_order=True)]
        last, drive_hz, end_ns, span_s = len(found), float(drive[-1]) if drive else 0.0, None, UNSETTLED_S
    first, origin_ns, tables = _newest_scans(run, last, span_s + HELD_S, rate_hz)
    rows = _joined(tables, origin_ns) if tables else np.empty(0, SCAN)
    if not len(rows):
        raise RecordingError(f"{run.path} holds no scans to draw")
    end_s = rows["time"][-1] if end_ns is None else (end_ns - origin_ns) / NS_PER_S
    within = (rows["time"] > end_s - span_s) & (rows["time"] < end_s + 0.5 / rate_hz)
    if np.count_nonzero(within) < FEWEST_SCANS:
        raise RecordingError(
            f"{run.path}: {np.count_nonzero(within)} scans without a gap at its end are too few to draw, "
            f"at least {FEWEST_SCANS} are needed"
        )
    rows = rows[within]
    impacts = [_joined(one.impacts, origin_ns)["time"] for one in found[first : last + 1] if one.impacts]
    times = np.concatenate(impacts) if impacts else np.empty(0)
    times = times[(times >= rows["time"][0]) & (times <= rows["time"][-1])]
    return Stretch(rows, rate_hz, drive_hz, times, settled=bool(settled))


def measured_curves(rows: NDArray[np.void]) -> dict[str, NDArray[np.void]]:
    """Return label -> settled rows of `transmissibility/table`, one curve per gap and direction of the sweep.

    A gap measured at one frequency only is no curve: there are curves where one gap has at least two frequencies.
    """
    rows = rows[rows["settled"] == 1.0]
    curves: dict[str, NDArray[np.void]] = {}
    for gap in sorted(set(np.nan_to_num(rows["gap"], nan=math.inf))):
        chosen = np.isnan(rows["gap"]) if math.isinf(gap) else rows["gap"] == gap
        steps = np.diff(rows["frequency"][chosen])
        if not np.any(steps):
            continue
        moves = np.flatnonzero(steps)
        # a point goes with the step that led to it, the first ones with the step that follows
        upwards = steps[moves[np.maximum(np.searchsorted(moves, np.arange(len(steps) + 1)) - 1, 0)]] > 0
        label = "gap unknown" if math.isinf(gap) else f"gap {gap * 1e3:g} mm" if gap else "no sphere"
        for way, there in (("up", upwards), ("down", ~upwards)):
            if np.all(there):
                curves[label] = rows[chosen]
            elif np.any(there):
                curves[f"{label}, {way}"] = rows[chosen][there]
    return curves


def _newest_scans(run: Run, last: int, span_s: float, rate_hz: float) -> tuple[int, int, list[Table]]:
    """Return the contiguous scans before block `last`: number and origin [ns] of their time, and the tables.

    Origin is the first scan of the run, or that after the last reset.
    """
    kept: deque[Table] = deque()
    first, origin_ns = 0, 0
    for number, table in enumerate(run.tables(topics.SCAN.name, recorded_order=True)):
        if number > last:
            break
        expected_ns = kept[-1].stamp_ns + len(kept[-1].rows) * NS_PER_S / rate_hz if kept else -math.inf
        if abs(table.stamp_ns - expected_ns) > 0.5 * NS_PER_S / rate_hz:
            if not kept or table.stamp_ns < kept[-1].stamp_ns:
                first, origin_ns = number, table.stamp_ns
            kept.clear()
        kept.append(table)
        while table.stamp_ns - kept[0].stamp_ns > span_s * NS_PER_S:
            kept.popleft()
    return first, origin_ns, list(kept)


def _joined(tables: Sequence[Table], origin_ns: int) -> NDArray[np.void]:
    """Return the rows of tables, one after the other, `time` since `origin_ns`."""
    parts = []
    for table in tables:
        rows = table.rows.copy()
        rows["time"] += (table.stamp_ns - origin_ns) / NS_PER_S
        parts.append(rows)
    return np.concatenate(parts)


def _save(figure: Figure, path: Path) -> Path:
    try:
        with files.written_whole(path, replace=False) as file:
            figure.savefig(file, format=path.suffix[1:], dpi=150)
    except OSError as error:
        raise RecordingError(f"{path} cannot be written: {error.strerror}") from error
    return path
