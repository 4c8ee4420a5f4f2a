"""What an operator does with a job, whatever stands on the bench: the rig in this process, or one behind topics.

The operator commands, lets a turn pass, looks at what was measured, and commands again. Both benches answer the same
calls with the same values, so the numbers are the same bits.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.stepped import Command, State, SteppedSine
from impact_rig.campaign.job import Job, Outcome
from impact_rig.errors import ImpactRigError
from impact_rig.instruments.scan import channels_of
from impact_rig.simtime import NS_PER_S

Trace = Mapping[str, NDArray[np.generic]]
TRUE_COLUMNS = ("x_b", "x_1", "x_2", "v_1", "v_2")


@attrs.frozen(eq=False)
class Turn:
    """What happened in one turn.

    Attributes:
        rows: measurements, rows of `transmissibility/table`, in order.
        trip: why the rig has stopped, or None.
    """

    rows: Sequence[np.void]
    trip: str | None


class Bench(Protocol):
    """A reset rig with a new analysis, made for one job."""

    def now_ns(self) -> int:
        """Return the rig time since the reset."""
        ...

    def command(self, command: Command) -> Sequence[tuple[float, float]]:
        """Command frequency, then current; return the accepted changes, each (frequency [Hz], current [A]).

        Raises:
            ImpactRigError: the rig refused.
        """
        ...

    def turn(self) -> Turn:
        """Let one block pass."""
        ...

    def trace(self) -> Trace:
        """Let a few blocks pass and return their scans and truth, see `columns`."""
        ...

    def lost_scans(self) -> int:
        """Return how many scans the analysis has missed."""
        ...


def operate(job: Job, make_bench: Callable[[Job], Bench]) -> Outcome:
    """Measure a job; whatever goes wrong in it is its outcome, not an exception."""
    started = time.perf_counter()
    sweep = SteppedSine(job.plan())
    bench: Bench | None = None
    failure, trace = "", {}
    try:
        bench = make_bench(job)
        _measure(sweep, bench)
        failure = sweep.reason
        if job.traces and sweep.state is State.FINISHED:
            trace = dict(bench.trace())
    except ImpactRigError as error:
        failure = str(error)
    return Outcome(
        rows=sweep.rows,
        failure=failure,
        skipped_hz=tuple(sweep.skipped),
        simulated_s=bench.now_ns() / NS_PER_S if bench else 0.0,
        wall_s=time.perf_counter() - started,
        lost_scans=bench.lost_scans() if bench else 0,
        trace=trace,
    )


def _measure(sweep: SteppedSine, bench: Bench) -> None:
    _obey(sweep, bench, sweep.start(bench.now_ns()))
    while sweep.state is State.RUNNING:
        turn = bench.turn()
        now = bench.now_ns()
        for row in turn.rows:
            command = sweep.on_measurement(row, now)
            if command is not None and sweep.state is State.RUNNING:  # at the end the rig is simply given up
                _obey(sweep, bench, command)
        if turn.trip is not None:
            sweep.abort(f"the rig tripped: {turn.trip}")
        sweep.on_time(now)


def _obey(sweep: SteppedSine, bench: Bench, command: Command) -> None:
    for frequency_hz, current_a in bench.command(command):
        sweep.on_applied(frequency_hz, current_a, bench.now_ns())


def columns(scans: NDArray[np.void], truth: NDArray[np.void], rate_hz: int) -> Trace:
    """Return consecutive scans and the truth at the same instants as columns; time from their first scan on [s].

    Args:
        scans: rows of `daq/scan`, shape (n,).
        truth: rows of `truth/scan`, shape (n,).
        rate_hz: scans per second.
    """
    found: dict[str, NDArray[np.generic]] = {"time": np.arange(len(scans)) / rate_hz}
    for rows, names in ((scans, channels_of(scans)), (truth, TRUE_COLUMNS)):
        found.update({name: rows[name].astype(np.float32) for name in names})
    return found
