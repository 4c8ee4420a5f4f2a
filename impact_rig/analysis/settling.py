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
"""Detection of settling: decides window by window whether the response to one drive setting has settled.

A window is a group of consecutive drive cycles (`window_cycles`). A row is a row of `transmissibility/table`.

A dying transient adds a term c·q^w to the complex transmissibility of window w. The complex number q describes decay
and beat of the free vibration against the drive. The remaining sum of the transient is extrapolated from the
differences of the windows (Aitken). This gives the bias of a mean, *including* the part that differences of neighbours
cannot show.

After each window, once enough windows have passed since the last row, three conditions for a row are tried in this
order:

1. steady: the bias that a transient leaves in the last `windows` windows is below `settle_tolerance` or twice the
  noise, and the amplitude repeats from cycle to cycle (or after a few cycles). The first row after a change waits until
  the bias, at the decay rate so far, is `REMNANT` of the limit;
2. stationary: the last `long_windows` windows have neither a trend nor a changing fluctuation (modulated or chaotic
  response). If the response does not repeat and impacts are counted, the windows contain at least `FEW` impacts. With
  fewer impacts, the fluctuation is the end of a transient, or the sphere has only started to strike;
3. the bound `wait_limit_s` is reached: the row has the present numbers and the status `not_settled`.

A sphere that drifts slowly from wall to wall does not disturb the structure until it strikes. A row without impacts is
therefore delayed for the time in which the slowest sphere considered crosses the gap, at most `wait_limit_s`
(`ImpactPause`). Even then the sphere may still strike, so the row has the status `no_impacts`. A motion with few
impacts at irregular times is measured over the long record.
"""

from __future__ import annotations

import math
from collections import deque

import attrs
import numpy as np

from impact_rig.analysis.calibration import Calibration, Complex
from impact_rig.analysis.cycles import Cycles, concatenate
from impact_rig.analysis.health import REFERENCE_FACTOR, SIGNAL_FACTOR, Amplitudes, Rejection, changed_alone, unsound
from impact_rig.analysis.scans import BASE, CHANNELS, LASER
from impact_rig.analysis.settings import TrackerSettings
from impact_rig.analysis.spread import variance_of_mean
from impact_rig.analysis.transmissibility import Measurement, complex_transmissibility, measure
from impact_rig.states import MEASURED, Regime, Status

SLOWEST_RATIO = 0.97
"""Largest |q|: the factor by which a transient decays from one quarter of the fitted windows to the next.

A fit cannot resolve slower transients, with time constants of more than 33 quarters.
"""
TREND_LIMIT = 3.0  # difference of the halves, in standard deviations, that still counts as no trend
POWER_LIMIT = 4.0  # ratio of the fluctuation power of the halves that still counts as stationary


def transient_bias(windows: Complex, measured: int) -> complex:
    """Return the complex bias that a dying transient leaves in the mean of the newest `measured` windows.

    The bias is this mean minus the limit that the response approaches. The limit is extrapolated from the newest 8
    windows and, if available, also from the newest 16, which show slow transients better. The larger of the two biases
    is returned. Without a transient, the bias is of the size of the noise.

    `windows` is the complex transmissibility in successive windows, oldest first, shape (n,).

    Raises:
        ValueError: not 8 <= measured <= n.
    """
    if not 8 <= measured <= len(windows):
        raise ValueError(f"measured must be >= 8 and <= {len(windows)} (the number of windows), got {measured}")
    mean = complex(windows[-measured:].mean())
    spans = [span for span in (8, 16) if span <= len(windows)]
    return max((mean - _limit(windows[-span:].reshape(4, -1).mean(axis=1)) for span in spans), key=abs)


def more_windows(taken: int, reached: float, share: float) -> int:
    """Return how many more windows a transient takes to decay to the share `share` of its present size.

    The transient is assumed to decay exponentially, and to have been as large as the response when the drive changed.
    If it fell to the fraction ε in n windows, it takes n ln(s) / ln(ε) more windows (rounded up) to fall by the factor
    s.

    Args:
        taken: n, the number of windows from the change of the drive to the first of the windows averaged now.
        reached: ε, the fraction of its first size below which the transient has fallen by now, or the noise limit if
            the transient is below the noise.
        share: s, 0 < s < 1.

    Returns:
        Number of windows; 0 if ε is not between 0 and 1, because the decay rate is then unknown.
    """
    return math.ceil(taken * math.log(share) / math.log(reached)) if 0.0 < reached < 1.0 else 0


def _limit(quarters: Complex) -> complex:
    """Return the limit of a decaying series, extrapolated from four successive values by Aitken's method.

    The factor q from one difference of neighbours to the next is fitted to the three differences by least squares. Its
    absolute value is limited to `SLOWEST_RATIO`. If the first two differences are zero, the limit is the last value.
    """
    steps = np.diff(quarters)
    power = float(np.sum(np.abs(steps[:-1]) ** 2))
    if power == 0.0:
        return complex(quarters[3])
    ratio = complex(np.sum(steps[1:] * np.conj(steps[:-1])) / power)
    if abs(ratio) > SLOWEST_RATIO:
        ratio *= SLOWEST_RATIO / abs(ratio)
    return complex(quarters[3] + steps[2] * ratio / (1.0 - ratio))


def is_stationary(windows: Complex) -> bool:
    """Return whether a fluctuating response has settled: it has no trend, and the fluctuation neither grows nor decays.

    `windows` is the complex transmissibility in successive windows, shape (n,), n >= 16. The two halves are compared;
    of an odd number, the last window is left out. In both components, their means must not differ by more than
    `TREND_LIMIT` standard deviations of the difference. Their fluctuation powers must not differ by more than the
    factor `POWER_LIMIT`.
    """
    half = len(windows) // 2
    first, second = windows[:half], windows[half : 2 * half]
    for a, b in ((first.real, second.real), (first.imag, second.imag)):
        scatter = variance_of_mean(a) + variance_of_mean(b)
        if (b.mean() - a.mean()) ** 2 > TREND_LIMIT**2 * scatter:
            return False
    powers = np.var(first), np.var(second)
    return bool(max(powers) <= POWER_LIMIT * min(powers))


CYCLE_MULTIPLE = 6
"""Number of drive cycles; every window holds a multiple of it.

Orbits of period 2, 3 and 6 close in each window, those of period 4 and 8 in pairs.
"""
NOISE_FACTOR = 2.0
FEW = 20  # number of impacts in a long record below which it does not represent the average of an irregular motion
SPARSE = 0.5  # impacts per cycle below which a motion with irregular impacts is measured over a long record
REMNANT = 0.02  # fraction of the bias limit that a transient may leave in the first measurement after a change


def window_cycles(frequency_hz: float, settings: TrackerSettings) -> int:
    """Return the number of drive cycles per window: the least multiple of CYCLE_MULTIPLE that lasts `window_s`."""
    return CYCLE_MULTIPLE * max(1, math.ceil(settings.window_s * frequency_hz / CYCLE_MULTIPLE))


NOTICED_S, NOTICED_CYCLES = 0.5, 2.0
"""Time without impacts, in seconds and in drive cycles, after which `Progress` shows the wait for the next impact."""


@attrs.frozen
class ImpactPause:
    """Time without impacts so far, and its limit up to which a row without impacts is delayed [s].

    The row is delayed because a slow sphere may still strike.
    """

    since_s: float = 0.0  # time since the last impact under drive, or since the gap was set or the drive started
    # time without impacts for which a row is delayed at most; 0 without a sphere, or if none was ever noticed
    bound_s: float = 0.0

    @property
    def is_waiting(self) -> bool:
        """Return whether a row without impacts is still delayed, because `since_s` is less than `bound_s`."""
        return self.since_s < self.bound_s


@attrs.frozen
class Progress:
    """Progress towards the first measurement after the last change, as numbers of windows.

    A window is a number of drive cycles that is measured at once. A change is a new drive, gap label or calibration, a
    loss of scans, a reset of the rig, or a window that cannot be measured before the first measurement. After the first
    measurement, the progress is complete. If the next measurement is overdue (`Judge.late`), the progress is that
    towards the next one.
    """

    windows: int  # number since the last change; at most `needed`
    needed: int  # estimated number required: it grows while no row can be given
    remnant: float  # remnant of the transient, relative to the transmissibility; NaN if not known yet
    quiet: ImpactPause = ImpactPause()  # wait for a sphere; without a bound if there is none

    @property
    def reason(self) -> str:
        """Sentence for users if the row is delayed because a sphere may still strike; otherwise empty.

        The sentence states the longest wait in seconds. The wait counts from the last impact, the start of the drive or
        the label of the gap, whichever is latest.
        """
        if not self.quiet.is_waiting:
            return ""
        return f"waiting up to {self.quiet.bound_s:.3g} s for a sphere that may still strike"


class Judge:
    """Decision logic for one drive setting, which keeps the newest windows and decides when they give a row."""

    def __init__(self, calibration: Calibration, frequency_hz: float, settings: TrackerSettings) -> None:
        self._calibration = calibration
        self.frequency_hz = frequency_hz
        self._settings = settings
        self._windows: deque[Cycles] = deque(maxlen=settings.long_windows)
        self._ratios: deque[complex] = deque(maxlen=settings.long_windows)
        self._since_row = 0
        self._span = 0  # number of windows from the newest row to the next one, for an unchanged response
        self._reported = False
        self._waited_windows = 0
        self._crowding = calibration.noise_crowding()
        self._scales = calibration.scales(frequency_hz)
        self._noise_per_scan = np.zeros(len(CHANNELS))  # variance near the drive in the newest window
        self._window_s = window_cycles(frequency_hz, settings) / frequency_hz
        self._broken: Status | None = None
        self._quiet = ImpactPause()
        self._held: Measurement | None = None  # the row of the newest windows, while the sphere may still strike
        self._stayed_away = False  # whether a row since the newest was delayed because the sphere may still strike
        self._whole = 0  # number of windows since the change of the drive, or since the last broken one
        self._reference: Amplitudes | None = None  # amplitudes of the newest good row of this setting
        self._due: int | None = None  # number of windows before the first measurement
        self._remnant = math.nan  # remnant of the transient, relative to the newest transmissibility

    def add(self, window: Cycles, quiet: ImpactPause = ImpactPause()) -> Measurement | None:
        """Add the next window of drive cycles; return a measurement if the response has settled or the wait is over.

        Otherwise the result is None. `quiet` is the wait for the sphere at the end of the window.

        An unsound window (such as over range, not finite or noisy) discards all windows so far and gives a measurement
        that has only a status. If the next windows are unsound for the same reason, only every `windows`-th of them
        gives this result again.
        """
        self._quiet = quiet
        self._since_row += 1
        self._waited_windows += 1
        broken = unsound(window, self._calibration, self.frequency_hz)
        if broken is None:
            self._noise_per_scan = self._crowding * np.maximum(window.residual_variance, self._calibration.noise**2)
            broken = self._lost_signal(window)
        if broken:
            return self._break(broken)
        self._broken = None
        self._whole += 1
        self._windows.append(window)
        self._ratios.append(complex_transmissibility(window, self._calibration, self.frequency_hz))
        short = self._settings.windows
        if len(self._windows) < short or (self._reported and self._since_row < short):
            return None
        found = self._steady() or self._stationary()
        tells_impacts = found is not None and found.status in MEASURED and not math.isnan(found.impacts_per_cycle)
        if tells_impacts and self._quiet.is_waiting and not self._struck():
            self._stayed_away, self._held = True, found
            return None
        return self._given(found or self._overdue())

    def finish(self) -> Measurement | None:
        """Return the measurement that is delayed because a sphere may still strike, or None if there is none.

        Call this when the record ends.
        """
        return self._given(self._held)

    def unsettled(self, rest: Cycles | None) -> Measurement | None:
        """Return a measurement for a record that ends before its first row, or None if a row was given.

        Rows of unsound windows do not count as given. The measurement uses the kept windows, at most the newest
        `long_windows`, and `rest`, the complete cycles after them. If it has numbers, its status is `not_settled`,
        because the remaining transient is unknown.
        """
        if self._reported:
            return None
        parts = [*self._windows, *([rest] if rest is not None else [])]
        if not parts:
            return Measurement(status=Status.TOO_FEW_CYCLES, frequency_hz=self.frequency_hz)
        cycles = concatenate(parts)
        found = measure(cycles, self._calibration, self.frequency_hz, self._settings, worst=math.inf)
        return attrs.evolve(found, status=Status.NOT_SETTLED) if found.status in MEASURED else found

    def _given(self, found: Measurement | None) -> Measurement | None:
        """Register a measurement as the newest row, and return the row to emit; None stays None.

        If one channel alone has changed since the last good row, that row has only a status and the name of the
        channel. A measurement without impacts gets the status `no_impacts` if a sphere may be present.
        """
        self._held = None
        if found:
            silent = found.status is Status.OK and found.impacts_per_cycle == 0.0 and self._quiet.bound_s > 0.0
            found = attrs.evolve(found, status=Status.NO_IMPACTS) if silent else found
            self._stayed_away = False
            self._span = max(self._settings.windows, found.cycles // len(self._windows[-1]))
            found = self._compared(found)
            self._since_row, self._waited_windows, self._reported = 0, 0, True
        return found

    @property
    def late(self) -> bool:
        """Return whether the next row is overdue: more windows have passed since the newest row than that row averaged.

        A row is late if the response has become less regular, or if a sphere may still strike.
        """
        return self._reported and self._since_row > self._span

    @property
    def pending(self) -> bool:
        """Return whether a measurement is in progress: windows have been added since the newest row."""
        return self._since_row > 0

    @property
    def progress(self) -> Progress:
        """Progress towards the first row of this drive setting, or towards a row that is overdue, in windows.

        At all other times, `windows` is equal to `needed`.
        """
        needed = max(self._settings.windows, self._due or 0)
        if self.late:
            return Progress(self._since_row, self._since_row + 1, self._remnant)
        if self._reported:
            return Progress(needed, needed, self._remnant)
        return Progress(self._whole, max(needed, self._whole + 1), self._remnant)  # no row yet: at least one more

    def _compared(self, found: Measurement) -> Measurement:
        """Return a measurement unchanged, unless one channel alone has changed since the last good row.

        In this case, the gain of the channel has changed, because the drive is the same. The result is then a
        measurement that has only a status and the name of the channel.
        """
        if found.amplitudes is None or found.status is Status.NOT_SETTLED:
            return found
        alone = changed_alone(self._reference, found.amplitudes) if self._reference else None
        if alone:
            return Measurement(
                status=alone.status, channel=alone.channel, frequency_hz=self.frequency_hz, cycles=found.cycles
            )
        if found.status is not Status.CURRENT_UNSOUND:  # otherwise the current would seem to change when it returns
            self._reference = found.amplitudes
        return found

    def _lost_signal(self, window: Cycles) -> Rejection | None:
        """Return a rejection if laser or base has lost its signal since the window before; else None.

        Only a signal that stands out clearly in a single window is considered.
        """
        if not self._windows:
            return None
        before = self._windows[-1]
        scans = float(window.samples.sum())
        for channel in (LASER, BASE):
            floor = SIGNAL_FACTOR * math.sqrt(2.0 * float(self._noise_per_scan[channel]) / scans)
            has = abs(complex(window.phasors[:, channel, 0].mean()))
            if has <= floor and abs(complex(before.phasors[:, channel, 0].mean())) > REFERENCE_FACTOR * floor:
                return Rejection(Status.NO_SIGNAL, CHANNELS[channel])
        return None

    def _break(self, why: Rejection) -> Measurement | None:
        status = why.status
        self._windows.clear()
        self._ratios.clear()
        self._whole, self._due, self._remnant, self._waited_windows = 0, None, math.nan, 0
        self._held, self._stayed_away = None, False
        if status is self._broken and self._since_row < self._settings.windows:
            return None
        self._broken, self._since_row = status, 0
        return Measurement(status=status, channel=why.channel, frequency_hz=self.frequency_hz)

    def _steady(self) -> Measurement | None:
        newest = abs(self._ratios[-1])
        limit = max(self._settings.settle_tolerance * newest, NOISE_FACTOR * self._noise(newest))
        bias = self._bias()
        self._remnant = abs(bias) / newest if newest > 0.0 else math.nan
        if abs(bias) > limit:
            return None
        if not self._reported and newest > 0.0:
            if self._due is None:
                taken = self._whole - self._settings.windows
                self._due = self._whole + more_windows(taken, limit / newest, REMNANT)
            if self._whole < self._due:
                return None
        found = self._measure(self._settings.windows, bias)
        if found.status not in MEASURED:
            return found
        sparse = found.regime is not Regime.PERIODIC and 0.0 < found.impacts_per_cycle < SPARSE  # a longer record helps
        return found if found.steady and not sparse else None

    def _struck(self) -> bool:
        """Return whether the newest `windows` windows, those of a short measurement, contain an impact."""
        return any(np.nansum(window.impacts) > 0 for window in list(self._windows)[-self._settings.windows :])

    def _stationary(self) -> Measurement | None:
        long = self._settings.long_windows
        if len(self._windows) < long or (self._reported and self._since_row < long):
            return None
        if not is_stationary(np.array(self._ratios)):
            return None
        found = self._measure(long, 0j)
        irregular = found.status in MEASURED and found.regime is not Regime.PERIODIC
        return None if irregular and found.impacts_per_cycle * found.cycles < FEW else found

    def _overdue(self) -> Measurement | None:
        limit_s = self._settings.wait_limit_s
        if self._stayed_away and not self._struck():
            limit_s *= 2.0  # only the sphere was waited for, which takes at most `limit_s` more
        if self._waited_windows * self._window_s < limit_s:
            return None
        found = self._measure(self._settings.windows, self._bias(), worst=math.inf)
        if found.status not in MEASURED:
            return found
        regime = Regime.INTERMITTENT if self._stayed_away else found.regime
        return attrs.evolve(found, status=Status.NOT_SETTLED, regime=regime)

    def _bias(self) -> complex:
        ratios = np.array(self._ratios)
        return transient_bias(ratios, self._settings.windows) if np.all(np.isfinite(ratios)) else 0j

    def _measure(self, windows: int, bias: complex, worst: float | None = None) -> Measurement:
        cycles = concatenate(list(self._windows)[-windows:])
        return measure(cycles, self._calibration, self.frequency_hz, self._settings, bias, self._reference, worst)

    def _noise(self, ratio: float) -> float:
        """Return the standard uncertainty of X_1 / X_b = `ratio` due to noise, if averaged over the setting `windows`.

        The noise is that of the newest window. The result is infinite if the base does not move or `ratio` is not
        finite.
        """
        window = self._windows[-1]
        moved = self._noise_per_scan / self._scales**2  # as displacement, like `ratio`
        base = abs(complex(window.phasors[:, BASE, 0].mean())) / float(self._scales[BASE])
        scans = float(window.samples.sum()) * self._settings.windows
        if base == 0.0 or not np.isfinite(ratio):
            return math.inf
        return math.sqrt(2.0 * float(moved[LASER] + ratio**2 * moved[BASE]) / scans) / base
