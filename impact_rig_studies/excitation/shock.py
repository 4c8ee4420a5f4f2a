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
"""Half-sine shocks of the inferior base, compensated so that a shaker can perform them, and shock response spectra.

A half sine of acceleration alone would leave the base with a permanent velocity. Two long, low pulses of the opposite
sign, one before and one after the half sine, bring velocity and displacement back to zero. Each has the shape of a
squared half sine.

The shock response spectrum states, for each natural frequency, the largest absolute acceleration of a one-mass
oscillator whose base has the acceleration a. The relative displacement x of the mass obeys x'' + 2ζω x' + ω² x = −a,
and its absolute acceleration is x'' + a. The spectrum is computed by the ramp-invariant filter (Smallwood 1981, Shock
and Vibration Bulletin 51, 279–287), which is exact for an acceleration that is linear between its samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

import attrs
import numpy as np
import scipy

from impact_rig.analysis.calibration import Calibration, Real
from impact_rig.driver.hardware import Hardware
from impact_rig_studies.excitation.history import ABOVE, Replicated, ReplicatePlan, replicate
from impact_rig_studies.excitation.signals import check_duration


@attrs.frozen(kw_only=True)
class Pulse:
    """Requested shock of the inferior base: a half sine of acceleration between two compensating pulses."""

    # largest acceleration of the half sine [m/s²]
    peak: float = attrs.field(default=20.0, validator=attrs.validators.gt(0.0))
    duration_s: float = attrs.field(default=11e-3, validator=attrs.validators.gt(0.0))  # duration of the half sine
    compensation_s: float = attrs.field(default=0.15, validator=attrs.validators.gt(0.0))
    """Duration of each of the two compensating pulses, one before and one after the half sine."""

    def acceleration(self, rate_hz: int) -> Real:
        """Return the acceleration of the whole shock, including both compensating pulses [m/s²], shape (n,).

        Velocity and displacement are zero at the end.

        Args:
            rate_hz: number of samples per second.

        Raises:
            ConfigError: the half sine or a compensating pulse has fewer than `SHORTEST` samples.
        """
        check_duration("duration_s", self.duration_s, rate_hz)
        check_duration("compensation_s", self.compensation_s, rate_hz)
        on, around = round(self.duration_s * rate_hz), round(self.compensation_s * rate_hz)
        pulse = self.peak * np.sin(np.pi * (np.arange(on) + 0.5) / on)
        hill = np.sin(np.pi * (np.arange(around) + 0.5) / around) ** 2
        before, after = np.zeros(on + 2 * around), np.zeros(on + 2 * around)
        whole = np.zeros(on + 2 * around)
        before[:around], after[-around:], whole[around : around + on] = hill, hill, pulse
        sums = np.array([[one.sum(), one.cumsum().sum()] for one in (before, after)]).T
        low = np.linalg.solve(sums, [-whole.sum(), -whole.cumsum().sum()])
        return np.asarray(whole + low[0] * before + low[1] * after)

    def displacement(self, rate_hz: int) -> Real:
        """Return the displacement of the inferior base during the shock [m], shape (n,); it begins and ends at zero.

        Args:
            rate_hz: number of samples per second.

        Raises:
            ConfigError: a pulse is too short for the rate, see `acceleration`.
        """
        acceleration = self.acceleration(rate_hz)
        velocity = np.cumsum(acceleration) / rate_hz
        return np.asarray((np.cumsum(velocity) - 0.5 * velocity) / rate_hz)


def shock_response_spectrum(acceleration: Real, rate_hz: float, frequency_hz: Real, quality: float = 10.0) -> Real:
    """Return the shock response spectrum of an acceleration: the largest responses of one-mass oscillators.

    Args:
        acceleration: acceleration of the base of the oscillators [m/s²], shape (n,).
        rate_hz: number of samples per second.
        frequency_hz: natural frequencies of the oscillators, shape (k,), > 0.
        quality: quality factor 1 / (2 ζ) of the oscillators, > 0.5; infinite without damping.

    Returns:
        The largest magnitude of the absolute acceleration at each natural frequency, during the shock and for one
        period after it [m/s²], shape (k,).
    """
    zeta = 0.5 / quality
    found = np.empty(len(frequency_hz))
    for i, natural in enumerate(frequency_hz):
        omega, t = 2.0 * math.pi * natural, 1.0 / rate_hz
        damped = omega * math.sqrt(1.0 - zeta * zeta)
        e, k = math.exp(-zeta * omega * t), damped * t
        c, s = e * math.cos(k), e * math.sin(k)
        ratio = s / k
        numerator = (1.0 - ratio, 2.0 * (ratio - c), e * e - ratio)
        ring = np.zeros(math.ceil(rate_hz / natural))  # the residual: a whole period of the free vibration
        response = scipy.signal.lfilter(numerator, (1.0, -2.0 * c, e * e), np.concatenate([acceleration, ring]))
        found[i] = np.abs(response).max()
    return found


def half_sine_spectrum(peak: float, duration_s: float, frequency_hz: Real) -> Real:
    """Return the undamped shock response spectrum of an ideal half sine of acceleration, in closed form.

    With r = 2 f τ, the largest response after the pulse is 2 r |cos(π r / 2)| / |1 − r²| times the peak. Where r > 1,
    the response during the pulse may be larger (Harris & Piersol 2002, Shock and Vibration Handbook, chapter 8).

    Args:
        peak: largest acceleration of the pulse [m/s²].
        duration_s: duration τ of the pulse.
        frequency_hz: natural frequencies f, shape (k,).

    Returns:
        The largest absolute acceleration at each natural frequency [m/s²], shape (k,).
    """
    r = 2.0 * frequency_hz * duration_s
    found = np.empty(len(r))
    for i, ratio in enumerate(r):
        if abs(ratio - 1.0) < 1e-9:
            found[i] = 0.5 * math.pi
            continue
        residual = 2.0 * ratio * abs(math.cos(0.5 * math.pi * ratio) / (1.0 - ratio * ratio))
        primary = 0.0
        if ratio > 1.0:
            # x''_abs = r/(r² − 1) (r sin θ − sin r θ), θ = πt/τ in 0 … π: extremes at θ = 2 π n / (r + 1)
            at = 2.0 * math.pi * np.arange(1, int((ratio + 1.0) / 2.0) + 1) / (ratio + 1.0)
            primary = float(np.abs(ratio / (ratio**2 - 1.0) * (ratio * np.sin(at) - np.sin(ratio * at))).max())
        found[i] = max(primary, residual)
    return peak * found


@attrs.frozen(eq=False, kw_only=True)
class Shocked:
    """Result of a shock test after a trial: the requested shock, and the best shock of the inferior base so far.

    The displacement sensor measures the base's motion. Each error of the shock has a floor in `floors`. An error up to
    its floor may be caused by the sensor alone, by its noise and the uncertainty of its gain.
    """

    followed: Replicated  # result of replicating the displacement, which contains the drive
    asked: Real  # requested acceleration [m/s²], shape (n,)
    reached: Real  # reached acceleration up to the frequency `CORNER` / duration of the pulse [m/s²], shape (n,)
    frequency_hz: Real  # natural frequencies of the spectra, shape (k,)
    srs_asked: Real  # shock response spectrum of the request, filtered like `reached` [m/s²], Q = 10, shape (k,)
    srs_reached: Real  # shock response spectrum of `reached`, likewise
    srs_ideal: Real  # shock response spectrum of the half sine alone, in closed form without damping, likewise
    peak_error: float  # relative error of the largest acceleration
    velocity_error: float  # relative error of the change of velocity during the half sine
    left_m: float  # measured displacement at the end of the shock, which should be zero
    srs_worst_db: float  # largest absolute difference of `srs_reached` from `srs_asked` [dB]
    floors: Mapping[str, float]  # floor of each of these four errors, by name of the attribute


DRAWS = 100  # number of simulated records of the sensor's noise; one error in 101 is larger than in any of them
CORNER = 3.0
"""Corner frequency of the filter for double differentiation, times the duration of the half sine.

The filter is needed because the noise of a differentiated displacement increases with the square of the frequency.
"""


def differentiated(displacement: Real, rate_hz: int, corner_hz: float) -> tuple[Real, Real]:
    """Return velocity [m/s] and acceleration [m/s²] of a displacement after a low-pass filter, shape (n,) each.

    The displacement must begin and end at zero, at rest.

    Args:
        displacement: the displacement [m], shape (n,).
        rate_hz: number of samples per second.
        corner_hz: frequency at which the low-pass filter halves the amplitude. The filter does not shift the phase.
    """
    padded = np.concatenate([displacement, np.zeros(len(displacement))])
    frequency: Real = np.asarray(np.fft.rfftfreq(len(padded), 1.0 / rate_hz), np.float64)
    i_omega = 2j * np.pi * frequency
    lines = np.fft.rfft(padded) / (1.0 + (frequency / corner_hz) ** 8)
    velocity, acceleration = (np.fft.irfft(i_omega**n * lines, len(padded))[: len(displacement)] for n in (1, 2))
    return velocity, acceleration


def shock(hardware: Hardware, pulse: Pulse, on_step: Callable[[str], object] = lambda _: None) -> Iterator[Shocked]:
    """Make the inferior base perform a shock by replicating its displacement in trials, see `history.replicate`.

    Args:
        hardware: output and acquisition, with equal rates.
        pulse: requested shock. Its displacement is replicated from 0 Hz up to `CORNER` / `pulse.duration_s`.
        on_step: receives a description of each step before the first trial, for the user.

    Yields:
        The best result so far after each trial, and once more after a repetition of the best drive.

    Raises:
        CommandError: the shaker trips or rejects the drive, samples arrive too late, scans are lost, or a reading
            exceeds `abort` of `hardware`. After an error, call `hardware.output.stop()`.
        ConfigError: the half sine or a compensating pulse is too short for the rate.
        BudgetError: a trial would have too many samples.
        TimeoutError: the rig did not advance.
    """
    rate_hz, corner_hz = hardware.rig.stream_rate_hz, CORNER / pulse.duration_s
    plan = ReplicatePlan(low_hz=0.0, high_hz=corner_hz, rest_s=1.0, identify_s=16.0, identify_rms=3.0, enough=1e-3)
    frequency = np.geomspace(5.0, corner_hz, 60)
    asked = pulse.acceleration(rate_hz)
    on = slice(round(pulse.compensation_s * rate_hz), round((pulse.compensation_s + pulse.duration_s) * rate_hz))
    ideal = half_sine_spectrum(pulse.peak, pulse.duration_s, frequency)
    displacement = pulse.displacement(rate_hz)
    wanted, smooth = differentiated(displacement, rate_hz, corner_hz)  # with the same filter as the result
    srs_asked = shock_response_spectrum(smooth, rate_hz, frequency)

    def figures(moved: Real) -> tuple[Real, Real, dict[str, float]]:
        velocity, reached = differentiated(moved, rate_hz, corner_hz)
        srs = shock_response_spectrum(reached, rate_hz, frequency)
        return reached, srs, {
            "peak_error": float(reached.max() / smooth.max() - 1.0),
            "velocity_error": float(np.ptp(velocity[on]) / np.ptp(wanted[on]) - 1.0),
            "left_m": float(moved[-1]), "srs_worst_db": float(np.abs(20.0 * np.log10(srs / srs_asked)).max()),
        }  # fmt: skip

    calibration = Calibration.from_info(hardware.info())
    gain = 2.0 * float(calibration.gain_uncertainty[plan.response.channel_index])
    noises = plan.response.noises(calibration, len(displacement), DRAWS, ABOVE * plan.high_hz)
    drawn = [figures(displacement + one)[2] for one in noises]
    of_gain = {"peak_error": gain, "velocity_error": gain, "left_m": 0.0, "srs_worst_db": 20.0 * math.log10(1.0 + gain)}
    floors = {name: max(abs(one[name]) for one in drawn) + least for name, least in of_gain.items()}
    for followed in replicate(hardware, displacement, plan, on_step):
        reached, srs_reached, found = figures(followed.reached)
        yield Shocked(
            followed=followed, asked=asked, reached=reached, frequency_hz=frequency, srs_asked=srs_asked,
            srs_reached=srs_reached, srs_ideal=ideal, floors=floors, **found,
        )  # fmt: skip
