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
"""Resonance search, track and dwell: the next setpoint, as a pure state machine.

    idle ── start ──► seeking ── phase crosses −90° ──► tracking ⇄ locked ── dwelt ──► finished
                         └──────────────── rule broken ─────────────┴───────────────► aborted

Seeking steps the frequency coarsely in the direction indicated by the phase, until the phase has crossed. Tracking
corrects the frequency continuously by a part of the detuning of each sample: an integral controller. Against the base
the detuning is known for any damping: 1/T = 1 − r² + 2iζr, so it is f/2 Re(X_b/X_1). Against the current it is tan φ'
(φ' = phase + 90°) times the slope of the resonance. The search has measured this slope, and tracking corrects it: the
slope was too large if the detuning changes sign from sample to sample, and too small if it keeps its sign.

A sample (`PhasorMeter`) is faster than a settled measurement: the scans of the last whole cycles at constant frequency
are fitted by a sine, and corrected for skew and lag by the certificate.

`LockedSine` locks with the updates of an operator. A program that drives a rig (`LockLoop`) continues with `follow` and
`lock_on`, and measures the backbone, an amplitude sweep of locks, with `sweep_amplitude`.
"""

from __future__ import annotations

import cmath
import enum
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.scans import BASE, CHANNELS, CURRENT, LASER
from impact_rig.analysis.spread import student_factor, variance_of_mean
from impact_rig.blocks import SWEEP, Table
from impact_rig.driver import RigDriver
from impact_rig.simtime import NS_PER_S
from impact_rig.states import Status
from impact_rig_studies.operate.plans import LockPlan, Reference
from impact_rig_studies.operate.stepped_sine import SAME, Setpoint, SweepState, sweep_rows

MIN_CYCLES = 2


class Sample(NamedTuple):
    """Sample of the motion: one stretch of scans."""

    end_ns: int  # rig time of its end
    frequency_hz: float  # drive frequency
    base: complex  # complex amplitude [m]; only ratios of the three are meaningful
    superior: complex  # complex amplitude [m]
    current: complex  # complex amplitude [A]
    u_gain: float = 0.0  # relative standard uncertainty of DT due to the sensitivities, at these amplitudes

    @property
    def dt(self) -> float:
        """|X_1| / |X_b|."""
        return abs(self.superior) / abs(self.base)

    @property
    def sound(self) -> bool:
        """Return whether all three are finite, and base and current are not zero."""
        sizes = abs(self.base), abs(self.superior), abs(self.current)
        return all(map(math.isfinite, sizes)) and sizes[0] > 0.0 and sizes[2] > 0.0


class PhasorMeter:
    """Sine fit of the newest scans."""

    def __init__(self, info: NDArray[np.void]) -> None:
        self._calibration = Calibration.from_info(info)

    def sample(self, rows: NDArray[np.void], frequency_hz: float, end_ns: int) -> Sample | None:
        """Return the phasors of consecutive scans at one frequency, or None if they are fewer than `MIN_CYCLES`.

        Args:
            rows: rows of `daq/scan`, shape (n,).
            frequency_hz: frequency of the drive during all of them.
            end_ns: rig time of the scan after the last.
        """
        period = self._calibration.rate_hz / frequency_hz
        cycles = math.floor(len(rows) / period)
        if cycles < MIN_CYCLES:
            return None
        kept = rows[len(rows) - round(cycles * period) :]
        angle = 2.0 * np.pi / period * np.arange(len(kept))
        basis = np.stack([np.ones(len(kept)), np.cos(angle), np.sin(angle)])
        values = np.stack([kept[CHANNELS[channel]].astype(float) for channel in (BASE, LASER, CURRENT)])
        found = np.linalg.solve(basis @ basis.T, basis @ values.T)
        phasors = found[1] - 1j * found[2]
        seen = [complex(self._calibration.response(channel, frequency_hz)) for channel in (BASE, LASER, CURRENT)]
        base, superior, current = (complex(y / r) for y, r in zip(phasors, seen, strict=True))
        u = [self._calibration.gain_uncertainty_at(ch, abs(x)) for ch, x in ((BASE, base), (LASER, superior))]
        return Sample(end_ns, frequency_hz, base, superior, current, math.hypot(*u))


STEEPEST = 4.0  # largest tan φ' that is used: beyond it, the phase only shows the direction of the resonance
MEAN_S = 1.0  # duration over which the phase is averaged
SMALLER, LARGER = 0.6, 1.25  # factors of the slope if the detuning overshoots, and if it persists
SLUGGISH = 4
"""Number of samples with a detuning of one sign and outside the bound from which the slope counts as too small."""
DIGITS = 6  # digits of a commanded frequency [Hz]


PHASE_LOCK = np.dtype([
    (name, SWEEP[name])
    for name in (
        "time", "frequency", "phase", "transmissibility", "laser_amplitude", "base_amplitude", "current_amplitude",
        "locked",
    )
])  # fmt: skip
"""Columns of `blocks.SWEEP` that a sample of a phase lock has; the phase is that against the reference."""


class Stage(enum.StrEnum):
    """Stage of a running lock."""

    SEEKING = "seeking"
    TRACKING = "tracking"
    LOCKED = "locked"


class PhaseLock:
    """State machine that seeks a resonance, tracks it, and dwells there.

    Attributes:
        state: running, finished, aborted.
        stage: stage of a running one.
        reason: why it was aborted; empty otherwise.
        frequency_hz: commanded frequency.
        current_a: commanded current.
        locked_ns: rig time of the first lock, or None.
    """

    def __init__(self, plan: LockPlan) -> None:
        self._plan = plan
        self.state, self.stage, self.reason = SweepState.IDLE, Stage.SEEKING, ""
        self.frequency_hz, self.current_a = plan.start_hz, plan.current_a
        self.locked_ns: int | None = None
        self.u_gain = 0.0
        self._began_ns = self._held_ns = 0
        self._tracked_ns = 0  # start of tracking at these settings
        self._rows: list[tuple[float, ...]] = []
        self._slope = 0.0  # Hz per tan φ'
        self._before: tuple[float, float] | None = None
        self._samples: list[tuple[int, complex]] = []
        self._signs = 0  # number of consecutive samples with a detuning of one sign, negative for a negative one

    @property
    def sample_s(self) -> float:
        """Duration of the next sample [s]."""
        return self._plan.seek_s if self.stage is Stage.SEEKING else self._plan.sample_s

    @property
    def rows(self) -> NDArray[np.void]:
        """All samples so far: rows of `PHASE_LOCK`, `time` from the start."""
        return np.array(self._rows, PHASE_LOCK)

    def rows_from(self, first: int) -> NDArray[np.void]:
        """Return the rows from one on; a negative number counts from the end."""
        return np.array(self._rows[first:], PHASE_LOCK)

    @property
    def locked(self) -> bool:
        """Return whether the phase is held now."""
        return self.state is SweepState.RUNNING and self.stage is Stage.LOCKED

    def start(self, now_ns: int) -> Setpoint:
        """Start the search."""
        self._began_ns = self._held_ns = now_ns
        self.state = SweepState.RUNNING
        return self._setpoint()

    def set_current(self, current_a: float, now_ns: int) -> Setpoint:
        """Continue with another current; a lock must be found again within the limit."""
        self.current_a = current_a
        self.unlock(now_ns)
        return self._setpoint()

    def unlock(self, now_ns: int) -> None:
        """Drop the lock, because a setting has changed and the phase must be found again."""
        if self.stage is Stage.LOCKED:
            self.stage = Stage.TRACKING
        self._held_ns = self._tracked_ns = now_ns
        self._samples.clear()

    def on_sample(self, sample: Sample) -> Setpoint:
        """Process a sample; return the next setpoint, equal to the last one if nothing changes."""
        if self.state is not SweepState.RUNNING:
            return self._setpoint()
        if not sample.sound:
            return self.abort("base or current do not move")
        if abs(sample.superior) > self._plan.superior_limit_m:
            return self.abort(f"the superior base swings {abs(sample.superior) * 1e3:.3g} mm")
        turned = sample.superior / (sample.base if self._plan.reference == Reference.BASE else sample.current)
        if self.stage is Stage.SEEKING:
            self._seek(turned)
            self._tracked_ns = sample.end_ns
        else:
            self._track(sample.end_ns, turned)
        self.u_gain = sample.u_gain
        self._note(sample, turned)
        self._watch(sample.end_ns)
        return self._setpoint()

    def abort(self, reason: str) -> Setpoint:
        """End, because the rig tripped or the operator requests it."""
        if self.state is SweepState.RUNNING:
            self.state, self.reason = SweepState.ABORTED, reason
        return self._setpoint()

    def _setpoint(self) -> Setpoint:
        return Setpoint(self.frequency_hz, self.current_a if self.state is SweepState.RUNNING else 0.0)

    def _seek(self, turned: complex) -> None:
        detuned = _detuning(turned)  # > 0: the resonance is above
        other, was = self._before or (self.frequency_hz, detuned)
        # if the range has limited the frequency, the phase crosses by itself as a transient decays: that is no slope
        if (was > 0.0) != (detuned > 0.0) and other != self.frequency_hz:
            self._slope = (self.frequency_hz - other) / (was - detuned)
            self.stage = Stage.TRACKING
            self._turn_to(self.frequency_hz + self._slope * detuned)
            return
        self._before = self.frequency_hz, detuned
        self._turn_to(self.frequency_hz + math.copysign(self._plan.step_hz, detuned))

    def _track(self, now_ns: int, turned: complex) -> None:
        share = min(1.0, self._plan.sample_s / self._plan.time_constant_s)
        self._turn_to(self.frequency_hz + share * self._detuning_hz(turned))
        self._samples.append((now_ns, turned / abs(turned)))
        first = now_ns - round(MEAN_S * NS_PER_S)
        self._samples = [one for one in self._samples if one[0] > first]
        whole = now_ns - self._tracked_ns >= MEAN_S * 0.999 * NS_PER_S  # a command may be delayed between two samples
        mean = sum(one for _, one in self._samples)
        if whole and abs(math.degrees(_turn_from_quarter(mean))) <= self._plan.within_deg:
            self.stage, self._held_ns = Stage.LOCKED, now_ns
            if self.locked_ns is None:
                self.locked_ns = now_ns
        elif whole:
            self.stage = Stage.TRACKING

    def _detuning_hz(self, turned: complex) -> float:
        """Return the distance of the resonance above the present frequency, at most a step of the search."""
        if self._plan.reference == Reference.BASE:
            detuning = 0.5 * self.frequency_hz * (1.0 / turned).real
        else:
            detuned = _detuning(turned)
            if abs(detuned) > math.tan(math.radians(self._plan.within_deg)):
                self._adapt(detuned)
            detuning = self._slope * detuned
        return min(max(detuning, -self._plan.step_hz), self._plan.step_hz)

    def _adapt(self, detuned: float) -> None:
        """Correct the slope according to the signs of the detunings."""
        if self._signs * detuned < 0.0:
            self._slope *= SMALLER
            self._signs = 0
        self._signs += 1 if detuned > 0.0 else -1
        if abs(self._signs) >= SLUGGISH:
            self._slope *= LARGER
            self._signs = 0

    def _turn_to(self, frequency_hz: float) -> None:
        self.frequency_hz = round(min(max(frequency_hz, self._plan.low_hz), self._plan.high_hz), DIGITS)

    def _note(self, sample: Sample, turned: complex) -> None:
        time_s = (sample.end_ns - self._began_ns) / NS_PER_S
        self._rows.append((
            time_s, sample.frequency_hz, cmath.phase(turned), sample.dt, abs(sample.superior), abs(sample.base),
            abs(sample.current), float(self.stage is Stage.LOCKED),
        ))  # fmt: skip

    def _watch(self, now_ns: int) -> None:
        plan, waited = self._plan, (now_ns - self._held_ns) / NS_PER_S
        if self.locked_ns is None:
            if waited > plan.seek_limit_s:
                self.abort(f"no resonance was found from {plan.start_hz:g} Hz within {plan.seek_limit_s:g} s")
        elif waited > plan.lose_limit_s:
            self.abort(f"the phase was not held for {plan.lose_limit_s:g} s")
        elif now_ns - self.locked_ns >= plan.dwell_s * NS_PER_S and self.stage is Stage.LOCKED:
            self.state = SweepState.FINISHED


def _turn_from_quarter(turned: complex) -> float:
    """Return φ' = phase + 90°, in (−π, π]."""
    return cmath.phase(turned * 1j)


def _detuning(turned: complex) -> float:
    """Return tan φ', bounded: the detuning in units of the slope."""
    angle = _turn_from_quarter(turned)
    if abs(angle) >= math.atan(STEEPEST):
        return math.copysign(STEEPEST, angle)
    return math.tan(angle)


class LockedSine:
    """Phase lock driven by the updates of an operator.

    Args:
        info: rows of `daq/info`.
        accept_limit_s: rig time within which a command must be accepted, and the next scans must arrive.
    """

    def __init__(self, plan: LockPlan, info: NDArray[np.void], accept_limit_s: float = 5.0) -> None:
        self._lock, self._meter = PhaseLock(plan), PhasorMeter(info)
        self._rate_hz, self._limit_s = float(info["rate"][0]), accept_limit_s
        self._wanted = Setpoint(plan.start_hz, plan.current_a)
        self._since_ns: int | None = None  # time from which the setpoint is active
        self._heard_ns = 0
        self._scans: list[NDArray[np.void]] = []
        self._end_ns = 0
        self.measured = 0  # number of samples

    @property
    def state(self) -> SweepState:
        """State of the lock."""
        return self._lock.state

    @property
    def reason(self) -> str:
        """Reason why it was aborted; empty otherwise."""
        return self._lock.reason

    @property
    def rows(self) -> NDArray[np.void]:
        """All samples so far: rows of `PHASE_LOCK`."""
        return self._lock.rows

    def sweep_from(self, first: int) -> NDArray[np.void]:
        """Return the rows from one on: rows of `blocks.SWEEP`."""
        found = sweep_rows(self._lock.rows_from(first))
        found["status"] = Status.OK.value
        return found

    def describe(self) -> str:
        """Return a readable description of the state."""
        at = f"{self._lock.frequency_hz:.6g} Hz"
        return (
            f"{self._lock.stage} at {at}" if self.state is SweepState.RUNNING else f"finished, the resonance is at {at}"
        )

    def figures(self) -> dict[str, float]:
        """Return the progress for programs."""
        phase = math.degrees(float(self._lock.rows_from(-1)["phase"][0])) if self.measured else math.nan
        locked = float(self._lock.locked)
        return {"samples": self.measured, "frequency_hz": self._lock.frequency_hz, "phase_deg": phase, "locked": locked}

    def start(self, now_ns: int) -> Setpoint:
        """Start the search."""
        return self._ask(self._lock.start(now_ns), now_ns)

    def on_applied(self, frequency_hz: float, current_a: float, now_ns: int) -> Setpoint | None:
        """Process an accepted change of the drive; a change by another client ends the lock."""
        if self.state is not SweepState.RUNNING:
            return None
        wanted = self._wanted
        if math.isclose(frequency_hz, wanted.frequency_hz, rel_tol=SAME) and math.isclose(
            current_a, wanted.current_a, rel_tol=SAME
        ):
            if self._since_ns is None:
                self._since_ns = self._heard_ns = now_ns
            return None
        if self._since_ns is not None:
            return self.abort(f"another client set {frequency_hz:g} Hz and {current_a:g} A")
        return None  # frequency and current are applied one after the other

    def on_measurement(self, row: np.void, now_ns: int) -> Setpoint | None:
        """Ignore a settled measurement: a lock is faster."""
        del row, now_ns
        return None

    def on_scans(self, table: Table) -> Setpoint | None:
        """Process a block of `daq/scan`; return the next setpoint once a stretch is complete."""
        rows, step_ns = table.rows, NS_PER_S / self._rate_hz
        if self.state is not SweepState.RUNNING or self._since_ns is None or not len(rows):
            return None
        if self._scans and abs(table.stamp_ns - self._end_ns) > step_ns / 2.0:
            self._scans.clear()  # scans are missing: the stretch restarts
        self._heard_ns = self._end_ns = table.stamp_ns + round(len(rows) * step_ns)
        early = max(0, math.ceil((self._since_ns - table.stamp_ns) / step_ns - 0.5))
        self._scans.append(rows[early:])
        if sum(map(len, self._scans)) < round(self._lock.sample_s * self._rate_hz):
            return None
        sample = self._meter.sample(np.concatenate(self._scans), self._wanted.frequency_hz, self._end_ns)
        if sample is None:
            return None  # a very low frequency: more scans are needed
        self._scans.clear()
        setpoint = self._lock.on_sample(sample)
        self.measured += 1
        if self.state is SweepState.RUNNING and setpoint == self._wanted:
            return None
        return self._ask(setpoint, self._end_ns)

    def on_time(self, now_ns: int) -> Setpoint | None:
        """Process the rig time; end the lock if a command is not accepted, or no scans arrive."""
        if self.state is not SweepState.RUNNING or (now_ns - self._heard_ns) / NS_PER_S <= self._limit_s:
            return None
        if self._since_ns is None:
            return self.abort(f"{self._wanted.frequency_hz:g} Hz was not accepted within {self._limit_s:g} s")
        return self.abort(f"no scans received for {self._limit_s:g} s")

    def abort(self, reason: str) -> Setpoint | None:
        """End a running lock, because the rig tripped or the operator requests it."""
        return self._lock.abort(reason) if self.state is SweepState.RUNNING else None

    def _ask(self, setpoint: Setpoint, now_ns: int) -> Setpoint:
        self._wanted, self._since_ns, self._heard_ns = setpoint, None, now_ns
        self._scans.clear()
        return setpoint


FEWEST = 6  # number of samples from which their scatter is meaningful
NEVER_S = 1e9  # rig time that no test reaches


class LockLoop:
    """Rig with a locked resonance, whose time advances only in `sample`.

    Args:
        rig: rig with blocks that are short compared with a sample.
    """

    def __init__(self, rig: RigDriver) -> None:
        self.rig = rig
        self._setpoint = Setpoint(rig.config.drive.frequency_hz, rig.config.drive.amplitude)

    @property
    def now_ns(self) -> int:
        """Rig time since the start [ns]."""
        return self.rig.now_ns

    def set(self, setpoint: Setpoint) -> None:
        """Command frequency, then current, if they have changed."""
        if self.rig.stopped:
            return
        if setpoint.frequency_hz != self._setpoint.frequency_hz:
            self.rig.command(frequency_hz=setpoint.frequency_hz)
        if setpoint.current_a != self._setpoint.current_a:
            self.rig.command(current_a=setpoint.current_a)
        self._setpoint = setpoint

    def sample(self, seconds: float) -> Sample | str:
        """Advance by a rig time and return the motion during it, or the reason why the rig stopped."""
        rig = self.rig
        rig.clear()
        rig.step(max(1, round(seconds * rig.rate_hz / rig.block_scans)))
        if rig.stopped:
            return rig.stopped
        rows, info = rig.rows(), rig.tables(topics.INFO.name)[-1].rows
        sample = PhasorMeter(info).sample(rows, self._setpoint.frequency_hz, rig.now_ns)
        return sample or f"{len(rows)} scans are too few for a sample"


def follow(lock: PhaseLock, loop: LockLoop, until: Callable[[PhaseLock], bool]) -> None:
    """Continue a started lock until it ends, or until a condition is true."""
    while lock.state is SweepState.RUNNING and not until(lock):
        now = loop.sample(lock.sample_s)
        setpoint = lock.abort(now) if isinstance(now, str) else lock.on_sample(now)
        loop.set(setpoint)


def lock_on(plan: LockPlan, loop: LockLoop) -> PhaseLock:
    """Search, track and dwell; return the final state of the lock."""
    lock = PhaseLock(plan)
    loop.set(lock.start(loop.now_ns))
    follow(lock, loop, lambda _: False)
    return lock


class Mean(NamedTuple):
    """Means of a locked stretch, with standard uncertainties."""

    frequency_hz: float  # of the resonance
    u_frequency_hz: float
    """Uncertainty from the scatter of the samples, their correlation, and the distance of the mean phase from −90°."""
    dt: float  # |X_1| / |X_b|
    u_dt: float  # from the scatter of the samples and the sensitivities, which are common to all measurements of a rig


def mean(rows: NDArray[np.void], u_gain: float) -> Mean:
    """Return the means of samples (`PHASE_LOCK`), shape (n,); uncertainties are NaN for fewer than `FEWEST`.

    Against the base the resonance is (f/2) Re(X_b/X_1) above the frequency of a sample, for any damping. If the mean
    phase is not −90°, this distance is uncertain.
    """
    frequency = float(np.mean(rows["frequency"]))
    dt = float(np.mean(rows["laser_amplitude"]) / np.mean(rows["base_amplitude"]))
    if len(rows) < FEWEST:
        return Mean(frequency, math.nan, dt, math.nan)
    widened = student_factor(len(rows))
    left = 0.5 * frequency * float(np.mean(np.cos(rows["phase"]) / rows["transmissibility"]))
    u_frequency = math.sqrt(variance_of_mean(rows["frequency"].astype(float)) * widened)
    u_dt = math.sqrt(variance_of_mean(rows["transmissibility"].astype(float)) * widened)
    return Mean(frequency, math.hypot(u_frequency, left), dt, math.hypot(u_dt, dt * u_gain))


@attrs.frozen(kw_only=True)
class AmplitudeSweep:
    """Amplitude sweep along a backbone: the locked loop over currents, up, then down."""

    currents_a: tuple[float, ...]  # ascending
    # plan of the lock; its current and dwell are not used, and its limit for lost locks applies to each point
    lock: LockPlan
    wait_s: float = 8.0
    """Rig time at each point, locked or given up, before it is measured; limits the remaining transient."""
    mean_s: float = 6.0  # rig time over which a point is averaged
    jump: float = 0.25  # relative change of DT between two points that is reported as a jump and not joined by a line


@attrs.frozen(kw_only=True)
class AmplitudePoint:
    """Point of an amplitude sweep."""

    direction: str  # up or down
    current_a: float  # commanded
    frequency_hz: float  # mean; u_frequency_hz is its standard uncertainty, see `Mean`
    u_frequency_hz: float
    dt: float  # ratio of the mean amplitudes; u_dt likewise
    u_dt: float
    spread: float  # relative standard deviation of DT from sample to sample
    superior_m: float  # mean amplitude
    base_m: float  # mean amplitude
    phase_deg: float  # mean
    locked: bool  # whether the phase was held in every sample; otherwise the numbers are means of a wandering motion
    jumped: bool  # whether the response differs from the previous point: DT jumped, or the lock appeared or was lost


def sweep_amplitude(sweep: AmplitudeSweep, loop: LockLoop) -> tuple[list[AmplitudePoint], str]:
    """Follow the backbone up and down; return its points, and why it ended early ("" if it did not)."""
    currents, bound = sweep.currents_a, sweep.lock
    lock = PhaseLock(attrs.evolve(bound, current_a=currents[0], dwell_s=NEVER_S, lose_limit_s=NEVER_S))
    loop.set(lock.start(loop.now_ns))
    points: list[AmplitudePoint] = []
    steps = [("up", current) for current in currents] + [("down", current) for current in currents[-2::-1]]
    for number, (direction, current) in enumerate(steps):
        if number:
            loop.set(lock.set_current(current, loop.now_ns))
        limit_s = bound.lose_limit_s if number else bound.seek_limit_s
        _pass(lock, loop, limit_s, lambda one: one.locked)
        _pass(lock, loop, sweep.wait_s)
        first = len(lock.rows)
        _pass(lock, loop, sweep.mean_s)
        if lock.state is not SweepState.RUNNING:
            return points, lock.reason
        points.append(_point(direction, current, lock.rows[first:], lock.u_gain, points[-1:], sweep.jump))
    lock.abort("done")
    loop.set(Setpoint(lock.frequency_hz, 0.0))
    return points, ""


def _pass(
    lock: PhaseLock, loop: LockLoop, seconds: float, until: Callable[[PhaseLock], bool] = lambda _: False
) -> None:
    """Follow a lock for a rig time, or until a condition is true."""
    end_ns = loop.now_ns + round(seconds * NS_PER_S)
    follow(lock, loop, lambda one: until(one) or loop.now_ns >= end_ns)


def _point(
    direction: str, current: float, rows: NDArray[np.void], u_gain: float, before: Sequence[AmplitudePoint], jump: float
) -> AmplitudePoint:
    ratio = np.mean(rows["transmissibility"] * np.exp(1j * rows["phase"]))
    means = mean(rows, u_gain)
    dt = means.dt
    locked = bool(np.all(rows["locked"] == 1.0))
    jumped = any(abs(math.log(dt / one.dt)) > math.log1p(jump) or one.locked != locked for one in before)
    return AmplitudePoint(
        direction=direction,
        current_a=current,
        frequency_hz=means.frequency_hz,
        u_frequency_hz=means.u_frequency_hz,
        dt=dt,
        u_dt=means.u_dt,
        spread=float(np.std(rows["transmissibility"]) / dt),
        superior_m=float(np.mean(rows["laser_amplitude"])),
        base_m=float(np.mean(rows["base_amplitude"])),
        phase_deg=math.degrees(float(np.angle(ratio))),
        locked=locked,
        jumped=jumped,
    )
