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
"""Phase lock: a state machine that searches for the resonance, tracks it, and stays there (dwell).

At the resonance, the phase φ of the superior base relative to a reference is −90°. The reference is the inferior base
or the current.

    idle ── start ──► seeking ── phase crosses −90° ──► tracking ⇄ locked ── dwell time over ──► finished
                         └─────────── time or amplitude limit, stop ┴──────────────────────────► aborted

Seeking steps the frequency in the direction indicated by the phase, until the phase has crossed −90°. Tracking then
corrects the frequency at each sample by a part of the detuning (resonance minus drive frequency), like an integral
controller.

If the inferior base is the reference, the detuning is known for any damping. The ratio T = X_1/X_b of superior to
inferior base fulfils 1/T = 1 − r² + 2iζr with r = f/f_n, so the detuning is f/2 Re(X_b/X_1). If the current is the
reference, the detuning is tan φ' (φ' = φ + 90°) times the slope of the resonance. The search measures this slope, and
tracking corrects it.

A sample (`PhasorMeter`) is faster than a settled measurement. It is a sine fit to the scans of the last whole cycles at
constant frequency. The calibration certificate corrects skew and lag of the sensors.

`LockedSine` is the lock for an `Operator`, which passes events of a rig to the lock. A program that drives a rig itself
uses `LockLoop` with `run_phase_lock` or `follow`. `measure_backbone` measures the backbone curve, which is the
resonance frequency over the amplitude.
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
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.simtime import NS_PER_S
from impact_rig.states import Status
from impact_rig_studies.operate.plans import LockPlan, Reference
from impact_rig_studies.operate.stepped_sine import SAME, Setpoint, SweepState, sweep_rows

MIN_CYCLES = 2  # smallest number of drive cycles in a sample


class Sample(NamedTuple):
    """Sample of the motion: complex amplitudes at the drive frequency, from the consecutive scans of some cycles.

    Only phase differences within one sample are meaningful. The common origin of its phases is arbitrary.
    """

    end_ns: int  # rig time of the end of its scans
    frequency_hz: float  # drive frequency
    base: complex  # displacement of the inferior base, peak [m]
    superior: complex  # displacement of the superior base, peak [m]
    current: complex  # current of the shaker, peak [A]
    u_gain: float = 0.0  # relative standard uncertainty of DT due to the sensors' sensitivities, at these amplitudes

    @property
    def dt(self) -> float:
        """Transmissibility: amplitude of the superior base divided by the amplitude of the inferior base.

        The amplitude of the inferior base must not be 0.
        """
        return abs(self.superior) / abs(self.base)

    @property
    def sound(self) -> bool:
        """Return whether the three amplitudes are finite and > 0; otherwise DT or a phase cannot be computed."""
        return all(math.isfinite(size) and size > 0.0 for size in map(abs, (self.base, self.superior, self.current)))


class PhasorMeter:
    """Meter that makes a `Sample` from scans: a sine fit, corrected by the calibration of the sensors.

    Args:
        info: rows of `daq/info`, with the calibration and the scan rate.
    """

    def __init__(self, info: NDArray[np.void]) -> None:
        self._calibration = Calibration.from_info(info)

    def sample(self, rows: NDArray[np.void], frequency_hz: float, end_ns: int) -> Sample | None:
        """Return the calibrated complex amplitudes at the drive frequency, from consecutive scans.

        Only the last whole drive cycles of the scans are used. Returns None if the scans contain fewer than
        `MIN_CYCLES` drive cycles.

        Args:
            rows: consecutive rows of `daq/scan`, shape (n,).
            frequency_hz: frequency of the drive during all these rows.
            end_ns: rig time of the scan after the last one.
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


STEEPEST = 4.0  # largest |tan φ'| that is used: beyond it, the phase only shows the direction of the resonance
MEAN_S = 1.0  # rig time over which the phase is averaged to decide whether it is locked
SMALLER, LARGER = 0.6, 1.25  # factors of the slope if the detuning changes sign, and if it keeps its sign
SLUGGISH = 4
"""Number of consecutive samples with a detuning of one sign, and outside the bound, that make the slope too small."""
DIGITS = 6  # digits of a commanded frequency [Hz]


PHASE_LOCK = np.dtype([
    (name, SWEEP[name])
    for name in (
        "time", "frequency", "phase", "transmissibility", "laser_amplitude", "base_amplitude", "current_amplitude",
        "locked",
    )
])  # fmt: skip
"""Row type of the samples of a phase lock: those columns of `blocks.SWEEP` that a sample has.

The phase is that of the superior base relative to the reference of the lock.
"""


class Stage(enum.StrEnum):
    """Stage of a running phase lock: coarse search, tracking, or locked.

    The frequency is corrected while tracking and while locked. The phase is locked if its mean over `MEAN_S` of rig
    time is within the plan's `within_deg` of −90°.
    """

    SEEKING = "seeking"
    TRACKING = "tracking"
    LOCKED = "locked"


class PhaseLock:
    """State machine that searches for a resonance, tracks it, and stays there for the dwell time.

    Its methods receive samples and return the next setpoint of the drive. Times are rig times [ns].

    Args:
        plan: range, speeds and limits of the search and of the lock.

    Attributes:
        state: state of the lock: idle, running, finished or aborted.
        stage: stage of a running lock.
        reason: reason why the lock was aborted; empty otherwise.
        frequency_hz: commanded frequency.
        current_a: peak current while the lock is running [A] (m or V by `drive.kind`); not 0 after its end.
        locked_ns: rig time of the first lock, or None.
        u_gain: relative standard uncertainty of DT due to the sensors' sensitivities, from the newest sample; 0 before
            the first.
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
        """Rig time that the next sample should comprise [s]: the plan's `seek_s` during the search, else `sample_s`."""
        return self._plan.seek_s if self.stage is Stage.SEEKING else self._plan.sample_s

    @property
    def rows(self) -> NDArray[np.void]:
        """Samples so far: rows of `PHASE_LOCK`, whose `time` is the rig time since the start of the lock [s].

        A sample with invalid or too large amplitudes, which aborts the lock, is left out.
        """
        return np.array(self._rows, PHASE_LOCK)

    def rows_from(self, first: int) -> NDArray[np.void]:
        """Return the samples from index `first` on, like `rows`; a negative index counts from the end."""
        return np.array(self._rows[first:], PHASE_LOCK)

    @property
    def locked(self) -> bool:
        """Return whether the lock is running, and its phase is locked at present (see `Stage`)."""
        return self.state is SweepState.RUNNING and self.stage is Stage.LOCKED

    def start(self, now_ns: int) -> Setpoint:
        """Start the search at rig time `now_ns` [ns], and return the first setpoint; call this only once."""
        self._began_ns = self._held_ns = now_ns
        self.state = SweepState.RUNNING
        return self._setpoint()

    def set_current(self, current_a: float, now_ns: int) -> Setpoint:
        """Change the peak current of the lock at rig time `now_ns` [ns], and return the new setpoint.

        The lock continues with tracking, or with an unfinished search. It is aborted if it does not lock again within
        the plan's `lose_limit_s`, or within `seek_limit_s` if it has never been locked. If the lock is not running, the
        setpoint has zero current.
        """
        self.current_a = current_a
        self.unlock(now_ns)
        return self._setpoint()

    def unlock(self, now_ns: int) -> None:
        """Leave the locked stage, because a setting of the rig has changed at rig time `now_ns` [ns].

        Tracking, or an unfinished search, continues. The time limit for a lock starts again. Earlier samples no longer
        count for the mean phase.
        """
        if self.stage is Stage.LOCKED:
            self.stage = Stage.TRACKING
        self._held_ns = self._tracked_ns = now_ns
        self._samples.clear()

    def on_sample(self, sample: Sample) -> Setpoint:
        """Process a sample measured at the last setpoint, and return the next setpoint.

        The next setpoint equals the last one if nothing changes, and has zero current if the lock has ended.
        """
        if self.state is not SweepState.RUNNING:
            return self._setpoint()
        if not sample.sound:
            return self.abort(
                "no phase can be measured: the amplitudes of inferior base, current and superior base must be finite "
                f"and > 0, got {abs(sample.base):g} m, {abs(sample.current):g} A and {abs(sample.superior):g} m"
            )
        if abs(sample.superior) > self._plan.superior_limit_m:
            return self.abort(
                f"the superior base swings {abs(sample.superior) * 1e3:.3g} mm, more than the limit of "
                f"{self._plan.superior_limit_m * 1e3:g} mm (superior_limit_m); lower the current or raise the limit"
            )
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
        """End a running lock as aborted, and return a setpoint with zero current.

        If the lock is not running, its state stays the same.

        Args:
            reason: reason for the user, which becomes `reason`.
        """
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
        """Estimate the detuning: resonance frequency minus drive frequency [Hz].

        The estimate is limited to ± one step of the search. If the current is the reference, this method also corrects
        the slope of the resonance.

        Args:
            turned: complex amplitude of the superior base over that of the reference; its phase is −90° at the
                resonance.
        """
        if self._plan.reference == Reference.BASE:
            detuning = 0.5 * self.frequency_hz * (1.0 / turned).real
        else:
            detuned = _detuning(turned)
            if abs(detuned) > math.tan(math.radians(self._plan.within_deg)):
                self._adapt(detuned)
            detuning = self._slope * detuned
        return min(max(detuning, -self._plan.step_hz), self._plan.step_hz)

    def _adapt(self, detuned: float) -> None:
        """Correct the slope of the resonance from the signs of successive detunings.

        A change of sign makes the slope smaller. `SLUGGISH` detunings with the same sign make it larger.

        Args:
            detuned: newest detuning as tan φ', with φ' = phase of the superior base relative to the current + 90°.
        """
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
                self.abort(
                    f"no lock within {plan.seek_limit_s:g} s of rig time, searching from {plan.start_hz:g} Hz between "
                    f"{plan.low_hz:g} and {plan.high_hz:g} Hz: the mean phase of a second was never within -90 ± "
                    f"{plan.within_deg:g} degrees; start nearer to the resonance, or use another current"
                )
        elif waited > plan.lose_limit_s:
            self.abort(
                f"the lock was lost: for {plan.lose_limit_s:g} s of rig time (lose_limit_s) the mean phase of a second "
                f"was not within -90 ± {plan.within_deg:g} degrees (within_deg); raise one of these limits, or use "
                "another current"
            )
        elif now_ns - self.locked_ns >= plan.dwell_s * NS_PER_S and self.stage is Stage.LOCKED:
            self.state = SweepState.FINISHED


def _turn_from_quarter(turned: complex) -> float:
    """Return the phase of `turned` + 90° in radians, in (−π, π]; it is 0 at the resonance.

    `turned` is the complex amplitude of the superior base over that of the reference (inferior base or current).
    """
    return cmath.phase(turned * 1j)


def _detuning(turned: complex) -> float:
    """Return tan φ', limited to ±`STEEPEST`; it is positive if the resonance is above the drive frequency.

    φ' is the phase of `turned` + 90°. `turned` is the complex amplitude of the superior base over that of the
    reference.
    """
    angle = _turn_from_quarter(turned)
    if abs(angle) >= math.atan(STEEPEST):
        return math.copysign(STEEPEST, angle)
    return math.tan(angle)


class LockedSine:
    """Phase lock for an `Operator`: it processes events of the rig, and makes samples from scans.

    Each `on_…` method returns the next setpoint of the drive, or None if the drive stays as it is.

    Args:
        plan: range, speeds and limits of the search and of the lock.
        info: rows of `daq/info`, with the calibration and the scan rate.
        accept_limit_s: longest rig time until the rig accepts a command, and between two blocks of scans; the lock is
            aborted after a longer time.

    Attributes:
        measured: number of samples so far, including a sample that aborted the lock.
    """

    def __init__(self, plan: LockPlan, info: NDArray[np.void], accept_limit_s: float) -> None:
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
        """State of the lock: idle, running, finished (the dwell time is over) or aborted (see `reason`)."""
        return self._lock.state

    @property
    def reason(self) -> str:
        """Reason why the lock was aborted; empty otherwise."""
        return self._lock.reason

    @property
    def rows(self) -> NDArray[np.void]:
        """Samples so far: rows of `PHASE_LOCK`, whose `time` is the rig time since the start of the lock [s].

        A sample with invalid or too large amplitudes, which aborts the lock, is left out.
        """
        return self._lock.rows

    def sweep_from(self, first: int) -> NDArray[np.void]:
        """Return the samples from index `first` on, as rows of `blocks.SWEEP`."""
        found = sweep_rows(self._lock.rows_from(first))
        found["status"] = Status.OK.value
        return found

    def describe(self) -> str:
        """Return the progress of the lock as text for the user, such as "tracking at 9.1 Hz".

        If the lock is idle or aborted, the text is only "idle" or "aborted", without the `reason`.
        """
        at = f"{self._lock.frequency_hz:.6g} Hz"
        running, finished = f"{self._lock.stage} at {at}", f"finished, the resonance is at {at}"
        return {SweepState.RUNNING: running, SweepState.FINISHED: finished}.get(self.state, str(self.state))

    def figures(self) -> dict[str, float]:
        """Return the progress for the diagnostics of a node: samples, frequency, phase [°] and whether it is locked.

        The phase is that of the newest sample, and NaN before the first one with a phase.
        """
        newest = self._lock.rows_from(-1)["phase"]
        phase = math.degrees(float(newest[0])) if len(newest) else math.nan
        locked = float(self._lock.locked)
        return {"samples": self.measured, "frequency_hz": self._lock.frequency_hz, "phase_deg": phase, "locked": locked}

    def start(self, now_ns: int) -> Setpoint:
        """Start the search at rig time `now_ns` [ns], and return the first setpoint; call this only once."""
        return self._ask(self._lock.start(now_ns), now_ns)

    def on_applied(self, frequency_hz: float, current_a: float, now_ns: int) -> Setpoint | None:
        """Process a change of the drive that the rig has accepted at rig time `now_ns` [ns].

        Scans count for the next sample once the rig has accepted the requested setpoint. A different setpoint after
        that aborts the lock, because another client must have commanded it. A different setpoint before that is
        ignored. Returns the setpoint with zero current after an abort, else None.
        """
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
            return self.abort(
                f"another client set {frequency_hz:g} Hz and the amplitude {current_a:g}; only one client may command "
                "the drive"
            )
        return None  # frequency and current are applied one after the other

    def on_measurement(self, row: np.void, now_ns: int) -> Setpoint | None:
        """Ignore a row of `transmissibility/table`, and return None: a lock cannot wait for settled measurements."""
        del row, now_ns
        return None

    def on_scans(self, table: Table) -> Setpoint | None:
        """Process a block of `daq/scan`, and return the next setpoint if the drive must change, else None.

        The setpoint can change when a sample is complete. Scans from before the rig accepted the present setpoint do
        not count. Missing scans restart the sample.
        """
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
        """Abort the lock if its command was not accepted, or no scans arrived, within `accept_limit_s`.

        `now_ns` is the present rig time [ns]. Returns the setpoint with zero current after an abort, else None.
        """
        if self.state is not SweepState.RUNNING or (now_ns - self._heard_ns) / NS_PER_S <= self._limit_s:
            return None
        if self._since_ns is None:
            return self.abort(
                f"the rig did not accept {self._wanted.frequency_hz:g} Hz and the amplitude {self._wanted.current_a:g} "
                f"within {self._limit_s:g} s of rig time (accept_limit_s)"
            )
        return self.abort(
            f"no scans received for {self._limit_s:g} s of rig time (accept_limit_s); check that daq/scan is published"
        )

    def abort(self, reason: str) -> Setpoint | None:
        """End a running lock as aborted because of an event outside of it, such as a trip of the rig.

        Returns the setpoint with zero current, or None if the lock is not running.

        Args:
            reason: reason for the user, which becomes `reason`.
        """
        return self._lock.abort(reason) if self.state is SweepState.RUNNING else None

    def _ask(self, setpoint: Setpoint, now_ns: int) -> Setpoint:
        self._wanted, self._since_ns, self._heard_ns = setpoint, None, now_ns
        self._scans.clear()
        return setpoint


FEWEST = 6  # number of samples from which their scatter is meaningful
NEVER_S = 1e9  # rig time that no test reaches
BLOCKS_PER_S = 20  # blocks of the rig in a loop: rig time passes in steps of 50 ms


def with_short_blocks(config: RigConfig) -> RigConfig:
    """Return the configuration with blocks of scans of about 50 ms, so that a controller can react after each."""
    return from_flat(config, {"daq.block_scans": max(1, config.daq.rate_hz // BLOCKS_PER_S)})


class LockLoop:
    """Drive and measurement of a rig for a phase lock, in a program that drives the rig itself.

    `set` commands the drive. `sample` advances the rig time and measures.

    Args:
        rig: the rig; its blocks of scans must be short compared with a sample, see `with_short_blocks`.
    """

    def __init__(self, rig: RigDriver) -> None:
        self.rig = rig
        self._setpoint = Setpoint(rig.config.drive.frequency_hz, rig.config.drive.amplitude)

    @property
    def now_ns(self) -> int:
        """Present rig time [ns]."""
        return self.rig.now_ns

    def set(self, setpoint: Setpoint) -> None:
        """Command a setpoint: the frequency, then the current.

        A value that has not changed since the previous call is not commanded again. The first call compares with the
        configuration of the rig. Nothing is commanded while the shaker of the rig is stopped.
        """
        if self.rig.stopped:
            return
        if setpoint.frequency_hz != self._setpoint.frequency_hz:
            self.rig.command(frequency_hz=setpoint.frequency_hz)
        if setpoint.current_a != self._setpoint.current_a:
            self.rig.command(current_a=setpoint.current_a)
        self._setpoint = setpoint

    def sample(self, seconds: float) -> Sample | str:
        """Advance the rig by `seconds` of rig time, and return the sample measured in this time.

        The time is rounded to blocks of scans, but is at least one block. If there is no sample, the result is a text
        that states why: the shaker is stopped, or the time was shorter than `MIN_CYCLES` drive cycles.
        """
        rig = self.rig
        rig.clear()
        rig.step(max(1, round(seconds * rig.rate_hz / rig.block_scans)))
        if rig.stopped:
            return rig.stopped
        rows, info = rig.rows(), rig.tables(topics.INFO.name)[-1].rows
        sample = PhasorMeter(info).sample(rows, self._setpoint.frequency_hz, rig.now_ns)
        return sample or (
            f"{len(rows)} scans are too few for a sample at {self._setpoint.frequency_hz:g} Hz: at least {MIN_CYCLES} "
            "cycles are needed; raise sample_s and seek_s"
        )


def follow(lock: PhaseLock, loop: LockLoop, until: Callable[[PhaseLock], bool]) -> None:
    """Continue a started lock on a rig, sample by sample, until it has ended or a condition is true.

    Args:
        lock: the lock; it is aborted if the shaker is stopped or a sample has too few scans.
        loop: the rig.
        until: condition, checked before each sample.

    Raises:
        CommandError: the rig rejects a command.
        TimeoutError: the rig did not advance.
    """
    while lock.state is SweepState.RUNNING and not until(lock):
        now = loop.sample(lock.sample_s)
        setpoint = lock.abort(now) if isinstance(now, str) else lock.on_sample(now)
        loop.set(setpoint)


def run_phase_lock(plan: LockPlan, loop: LockLoop) -> PhaseLock:
    """Run a complete phase lock on a rig (search, track, dwell), and return it, finished or aborted.

    At the end the current is set to zero, unless the shaker is stopped.

    Args:
        plan: range, speeds and limits of the lock.
        loop: the rig.

    Raises:
        CommandError: the rig rejects a command.
        TimeoutError: the rig did not advance.
    """
    lock = PhaseLock(plan)
    loop.set(lock.start(loop.now_ns))
    follow(lock, loop, lambda _: False)
    return lock


class Mean(NamedTuple):
    """Mean resonance frequency and transmissibility while the phase was locked, with standard uncertainties."""

    frequency_hz: float  # resonance frequency
    u_frequency_hz: float
    """Standard uncertainty of frequency_hz: from scatter and correlation of the samples, and the mean detuning."""
    dt: float  # transmissibility: amplitude of the superior base over that of the inferior base
    u_dt: float
    """Standard uncertainty of dt: from the scatter of the samples, and from the sensors' sensitivities.

    The errors of the sensitivities are the same in all measurements of a rig.
    """


def mean(rows: NDArray[np.void], u_gain: float) -> Mean:
    """Return resonance frequency and transmissibility as means of the samples of a lock, with their uncertainties.

    The transmissibility is the ratio of the mean amplitudes. The mean detuning of the samples is a part of the
    frequency's uncertainty. It does not correct the frequency. The detuning of a sample is (f/2) Re(X_b/X_1), with the
    drive frequency f. This formula is exact if the inferior base is the reference of the lock, and an estimate if the
    current is.

    Args:
        rows: samples (`PHASE_LOCK`) while locked, shape (n,); the uncertainties are NaN for fewer than `FEWEST`.
        u_gain: relative standard uncertainty of DT due to the sensors' sensitivities.
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
    """Plan of the measurement of a backbone curve: the resonance at ascending, then descending currents.

    The highest current is measured only once. The currents must be ascending, which is not checked.
    """

    currents_a: tuple[float, ...]  # peak currents [A], ascending
    # plan of the lock: its current and dwell time are not used, and its limit for a lost lock applies to each point
    lock: LockPlan
    wait_s: float = 8.0
    """Rig time at each point, after it has locked or the limit has passed, before it is measured.

    It must be long enough for the transient to decay.
    """
    mean_s: float = 6.0  # rig time over which a point is averaged
    jump: float = 0.25  # relative change of DT between two points that is reported as a jump and not joined by a line


@attrs.frozen(kw_only=True)
class AmplitudePoint:
    """Measured point of a backbone curve: resonance and amplitudes at one current."""

    direction: str  # up or down: whether the currents were ascending or descending
    current_a: float  # commanded peak current
    frequency_hz: float  # mean resonance frequency
    u_frequency_hz: float  # standard uncertainty of frequency_hz, see `Mean`
    dt: float  # transmissibility: ratio of the mean amplitudes of superior and inferior base
    u_dt: float  # standard uncertainty of dt, see `Mean`
    spread: float  # relative standard deviation of DT from sample to sample
    superior_m: float  # mean amplitude of the superior base, peak
    base_m: float  # mean amplitude of the inferior base, peak
    phase_deg: float  # mean phase of the superior base relative to the reference
    locked: bool  # whether the phase was locked in every sample; otherwise the values are means of a varying motion
    jumped: bool  # whether DT changed from the previous point by more than `AmplitudeSweep.jump`, or `locked` changed


def measure_backbone(sweep: AmplitudeSweep, loop: LockLoop) -> tuple[list[AmplitudePoint], str]:
    """Measure a backbone curve: lock the phase at each current, first ascending then descending, and average.

    The measurement ends early if the lock is aborted. Examples are a stopped shaker, a superior base above its limit,
    or no lock at the first current. If a later point does not lock in time, the point is still measured and marked as
    not locked.

    Args:
        sweep: currents, plan of the lock, and times.
        loop: the rig.

    Returns:
        The measured points, and the reason why the sweep ended early ("" if it did not). In both cases the current is
        set to zero, unless the shaker is stopped.

    Raises:
        CommandError: the rig rejects a command.
        TimeoutError: the rig did not advance.
    """
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
    """Continue a lock until some rig time has passed, a condition is true, or the lock ends.

    `seconds` is rounded up to whole samples.
    """
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
