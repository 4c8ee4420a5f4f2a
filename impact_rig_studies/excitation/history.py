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
"""Time histories: `play` sends samples unchanged to the drive, `replicate` makes a response of the rig follow them.

Replication is iterative learning in trials. X is the spectrum of the requested history, Y that of the measured
response, H the response function from drive to response, and F⁻¹ the inverse Fourier transform:

    drive_1 = F⁻¹ [X / H],    drive_{n+1} = drive_best + g F⁻¹ [(X − Y_best) / H]

`best` is the trial with the smallest error so far. The gain g is at most 1. It halves after each trial that is worse
than the best trial, and doubles after a better trial, because with a sphere the response is not linear. If g falls
below `LEAST_GAIN`, the next correction starts from the latest trial; without bursts (below) the trials end.

A response is the motion, not the reading: the known behaviour of its sensor is corrected (`response.motion`). The floor
of the error is the error that the noise of the sensor and the uncertainty of its gain can explain.

H is measured first, with a frame that must be longer than the structure takes to stop ringing.

Corrections remove only errors that repeat. A sphere that rolls freely begins each trial at another position, so equal
drives give different responses. If equal trials differ by more than noise, each trial begins with a burst: a sine at
the resonance of the superior base. If the sphere's motion in the burst is regular, it does not depend on what preceded
the burst. Bursts of several amplitudes are tried until equal trials agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Calibration, Complex, Real
from impact_rig.driver.hardware import Exchange, Hardware
from impact_rig.errors import ConfigError
from impact_rig_studies.excitation.response import Response, complete
from impact_rig_studies.excitation.signals import PSEUDO, Excitation, check_duration

LEAST_GAIN = 0.2  # gain below which a correction is given up

ABOVE = 1.25  # frequency above which nothing is corrected, as a multiple of the upper band edge
FRAMES = 3  # number of measured frames of the identification of H; one more precedes them
BESIDE = 25  # number of frequency lines over which the noise of H is averaged
NOISES = 4.0  # multiple of the variance of H's noise that is added to |H|² in the inverse of H

REPEATS = 5  # number of equal trials that must agree
WEAKER = 0.1  # step by which the drive of the trials between them decreases, to vary what precedes them
AGREEMENT = 1.2, 0.1  # largest scatter of trials that agree: multiple of the sensor's noise, or of `enough`
BURSTS = (0.0, 1.0, 0.8, 0.64, 0.5, 0.4, 0.32)
"""Amplitudes of the bursts that are tried, as fractions of the largest possible one."""
BURST_EDGE_S = 0.5  # duration of the rise and of the fall of a burst [s]


@attrs.frozen(kw_only=True)
class ReplicatePlan:
    """Settings of the replication of a time history by a response of the rig.

    Attributes:
        low_hz: lower edge of the band in which the drive is corrected; 0 includes the static value. The correction
            fades out from there to `low_hz` / 2.
        high_hz: upper edge of that band; the correction fades out from there to `ABOVE` times `high_hz`.
        iterations: maximum number of trials, including the first.
        enough: error at or below which the trials end: rms error over rms of the requested history.
        rest_s: time before and after the history in each trial [s]; its outer half is without drive.
        identify_rms: rms of the drive while the response function is measured [A].
        identify_s: length of a frame of that measurement minus the length of a trial without a burst [s]; four frames
            are played.
        burst_s: duration of the burst before each trial [s], at least 1; at most `identify_s` is used. The burst brings
            the sphere into the same motion before each trial. It is played only if equal trials differ without one.
        response: response that follows the history, one of `Response` except `BASE_ACCELERATION`, which has no sensor.
        seed: seed of the random phases of the drive while the response function is measured.
    """

    low_hz: float = attrs.field(default=2.0, validator=attrs.validators.ge(0.0))
    high_hz: float = attrs.field(default=150.0, validator=attrs.validators.gt(0.0))
    iterations: int = attrs.field(default=20, validator=attrs.validators.ge(1))
    enough: float = attrs.field(default=0.005, validator=attrs.validators.ge(0.0))
    rest_s: float = attrs.field(default=2.0, validator=attrs.validators.gt(0.0))
    identify_rms: float = attrs.field(default=2.0, validator=attrs.validators.gt(0.0))
    identify_s: float = attrs.field(default=32.0, validator=attrs.validators.gt(0.0))
    burst_s: float = attrs.field(default=8.0, validator=attrs.validators.ge(2.0 * BURST_EDGE_S))
    response: Response = attrs.field(default=Response.BASE, converter=Response)
    seed: int = 1

    @response.validator
    def _has_a_sensor(self, _attribute: object, response: Response) -> None:
        if response is Response.BASE_ACCELERATION:
            others = ", ".join(one for one in Response if one is not response)
            raise ValueError(
                f"response must be one that a sensor measures ({others}), got {response}, which is computed"
            )


@attrs.frozen(eq=False, kw_only=True)
class Replicated:
    """Result of a replication after a trial: requested history, and drive and response of the best trial so far.

    The best trial is the one with the smallest error.
    """

    rate_hz: int  # samples per second
    asked: Real  # requested history in the SI unit of the response, shape (n,)
    reached: Real  # measured response of the best trial, low-pass filtered at `ABOVE` times the band edge, likewise
    linear: Real
    """Response that the measured H predicts for the drive of the best trial, likewise.

    If it differs from `reached`, the rig is not linear, or its sensors are noisy.
    """
    drive: Real  # drive of the whole best trial, with burst and rest before the history and rest after it, (m,) [A]
    burst: int  # number of samples in `drive` of the burst and the rest around it; 0 without a burst
    lead: int  # number of samples in `drive` before the history
    errors: tuple[float, ...]  # rms error over rms of the requested history, for each trial so far
    floor: float
    """Largest such error that the sensor's noise and twice the standard uncertainty of its gain can explain."""
    repeated: float | None = None  # such an error in a repetition of the best drive; None before the repetition

    @property
    def quiet(self) -> slice:
        """Slice of samples in `drive` before the history, with the rig at rest, whose mean response is subtracted."""
        rest = self.lead - self.burst
        return slice(self.burst + rest // 4, self.burst + max(1, rest // 2))

    def relative(self, rest: Real) -> float:
        """Return the rms of a difference, divided by the rms of the requested history.

        Args:
            rest: difference in the unit of the history, such as `reached − linear`, shape (n,).
        """
        return float(np.sqrt(np.mean(rest**2) / np.mean(self.asked**2)))


def replicate(
    hardware: Hardware, asked: Real, plan: ReplicatePlan, on_step: Callable[[str], object] = lambda _: None
) -> Iterator[Replicated]:
    """Make a response of the rig follow a time history by correcting the drive in trials.

    Args:
        hardware: output and acquisition, with equal rates.
        asked: the history in the SI unit of the response, shape (n,); it begins and ends near zero.
        plan: settings.
        on_step: receives a description of each step before the first trial, for the user.

    Yields:
        After each trial, the best result so far with the errors of all trials. The trials end when the error is small
        enough or after the maximum number. Without bursts (see `ReplicatePlan.burst_s`), they also end when corrections
        no longer reduce the error. Then the best drive is repeated: the last result differs from the one before only in
        `repeated`.

    Raises:
        CommandError: the shaker trips or rejects the drive, samples arrive too late, scans are lost, or a reading
            exceeds `abort` of `hardware`. After an error, call `hardware.output.stop()`.
        ConfigError: `low_hz` and `high_hz` of the plan leave no band below half of the rate, or `identify_s` is too
            short for the rate.
        BudgetError: a trial would have too many samples.
        TimeoutError: the rig did not advance.
    """
    rate_hz = hardware.rig.stream_rate_hz
    lead = round(plan.rest_s * rate_hz)
    played = len(asked) + 2 * lead
    check_duration("identify_s", plan.identify_s, rate_hz)
    length = played + round(plan.identify_s * rate_hz)
    target = np.zeros(length)
    history = slice(lead, lead + len(asked))
    target[history] = asked
    calibration = Calibration.from_info(hardware.info())
    (h, inverse), superior = _identify(hardware, plan, length, calibration)
    top_hz = min(ABOVE * plan.high_hz, 0.5 * rate_hz)
    rms = float(np.sqrt(np.mean(asked**2)))
    noise = float(plan.response.noises(calibration, len(asked), 1, top_hz).std()) / rms
    floor = math.hypot(noise, 2.0 * float(calibration.gain_uncertainty[plan.response.channel_index]))
    agreement = max(AGREEMENT[0] * noise, AGREEMENT[1] * plan.enough)
    fade = _fade(played, lead)

    def respond(burst: Real, drive: Real) -> Real:
        samples = np.concatenate([burst, drive[:played]])
        read = complete(hardware.respond(samples), len(samples))
        found = plan.response.of(read, calibration, top_hz)[len(burst) :]
        return np.asarray(found - found[lead // 4 : max(1, lead // 2)].mean())

    drive = np.fft.irfft(inverse * np.fft.rfft(target), length)
    drive[:played] *= fade
    drive[played:] = 0.0
    on_step("response function measured")
    largest = _burst(plan, rate_hz, drive, *superior)
    burst = _steadying(lambda tried, by: respond(tried, by)[history] / rms, drive, largest, agreement, on_step)
    errors: list[float] = []
    best: Replicated | None = None
    gain = 1.0
    for _ in range(plan.iterations):
        reached = respond(burst, drive)
        miss = np.zeros(length)
        miss[:played] = fade * (target[:played] - reached)
        errors.append(float(np.sqrt(np.mean(miss[history] ** 2))) / rms)
        improves = best is None or errors[-1] <= min(errors)
        if improves:
            linear = np.fft.irfft(h * np.fft.rfft(drive), length)[history]
            best = Replicated(
                rate_hz=rate_hz, asked=asked, reached=reached[history], linear=linear,
                drive=np.concatenate([burst, drive[:played]]), burst=len(burst), lead=len(burst) + lead, errors=(),
                floor=floor,
            )  # fmt: skip
        assert best is not None
        yield attrs.evolve(best, errors=tuple(errors))
        gain = min(1.0, 2.0 * gain) if improves else 0.5 * gain
        given_up = gain < LEAST_GAIN
        if errors[-1] <= plan.enough or (given_up and not len(burst)):
            break
        if improves or given_up:
            start, correction = drive[:played].copy(), np.fft.irfft(inverse * np.fft.rfft(miss), length)[:played]
            gain = 1.0 if given_up else gain
        drive[:played] = fade * (start + gain * correction)
    assert best is not None
    again = respond(burst, best.drive[len(burst) :])[history]
    yield attrs.evolve(best, errors=tuple(errors), repeated=best.relative(again - asked))


def _steadying(
    respond: Callable[[Real, Real], Real],
    drive: Real,
    largest: Real,
    agreement: float,
    on_step: Callable[[str], object],
) -> Real:
    """Try the bursts of `BURSTS`; return the first after which equal trials agree, or else the best of all.

    Args:
        respond: function that plays a burst and a drive, and returns the response, relative to the rms of the history.
        drive: drive of the trials [A].
        largest: drive of the largest possible burst [A].
        agreement: largest scatter of trials that agree, in the unit of `respond`.
        on_step: receives a description of each step for the user.

    Returns:
        Drive of this burst [A], shape (n,). It is empty if trials agree without a burst, or if no burst improves their
        agreement.
    """
    scatters, tried = [], []
    for amplitude in BURSTS:
        tried.append(amplitude * largest if amplitude else np.empty(0))
        found, scatter = [respond(tried[-1], drive)], 0.0
        while len(found) < REPEATS and scatter <= agreement:
            respond(tried[-1], (1.0 - WEAKER * len(found)) * drive)  # another past
            found.append(respond(tried[-1], drive))
            scatter = float(np.sqrt(np.var(found, axis=0, ddof=1).mean()))
        scatters.append(scatter)
        before = f"after a burst of {np.abs(tried[-1]).max():.2f} A peak" if len(tried[-1]) else "without a burst"
        on_step(f"{len(found)} equal trials {before} differ by {100 * scatter:.2f} % of the history")
        if scatter <= agreement:
            break
    return tried[int(np.argmin(scatters))]


def _fade(count: int, lead: int) -> Real:
    """Return a window that is 1 during a signal, and 0 in the outer halves of the rests before and after the signal.

    Args:
        count: number of samples of the signal and both rests.
        lead: number of samples of each rest.
    """
    fade = np.sin(0.5 * np.pi * np.clip(4.0 * np.arange(count) / max(1, lead) - 2.0, 0.0, 1.0)) ** 2
    return np.asarray(fade * fade[::-1])


def _burst(plan: ReplicatePlan, rate_hz: int, drive: Real, h: Complex, inverse: Complex) -> Real:
    """Return the drive of the largest burst to play before a trial, with a rest around it [A], shape (n,), n <= m.

    The peak of this drive does not exceed the peak of the history's drive. The peak of the motion that this drive
    causes at the superior base does not exceed the peak that the history's drive causes there.

    Args:
        plan: settings.
        rate_hz: number of samples per second.
        drive: drive of the history in a frame [A], shape (m,).
        h: response function of the superior base at the frequency lines of a frame of m samples.
        inverse: inverse of `h`, as from `_identify`.
    """
    length, lead = len(drive), round(plan.rest_s * rate_hz)
    count = min(round(min(plan.burst_s, plan.identify_s) * rate_hz), length - 2 * lead)
    cycles = (1 + int(np.argmax(np.abs(h[1:])))) / length * np.arange(count)
    edges = scipy.signal.windows.tukey(count, min(1.0, 2.0 * BURST_EDGE_S * rate_hz / count))
    moved, burst = np.zeros((2, length))
    moved[lead : lead + count] = edges * np.sin(2.0 * np.pi * cycles)
    burst[: count + 2 * lead] = np.fft.irfft(inverse * np.fft.rfft(moved), length)[: count + 2 * lead]
    burst[: count + 2 * lead] *= _fade(count + 2 * lead, lead)

    def peaks(samples: Real) -> Real:
        return np.array([np.abs(samples).max(), np.abs(np.fft.irfft(h * np.fft.rfft(samples), length)).max()])

    return np.asarray((peaks(drive) / peaks(burst)).min() * burst[: count + 2 * lead])


def _identify(
    hardware: Hardware, plan: ReplicatePlan, length: int, calibration: Calibration
) -> list[tuple[Complex, Complex]]:
    """Measure two response functions H by playing pseudo-random noise.

    They lead from the drive to the response of the plan, and to the displacement of the superior base, in this order.

    Args:
        hardware: output and acquisition.
        plan: settings, with the band, the response and the level of the noise.
        length: number of samples of a frame, which defines the frequency lines.
        calibration: calibration of the sensors.

    Returns:
        For each response (H, 1 / H) at the lines of `numpy.fft.rfft`. Both are 0 below `low_hz` / 2 and above `ABOVE`
        times `high_hz`. 1 / H fades out from the edges of the band to these limits, and is reduced where noise hides H.
    """
    rate_hz = hardware.rig.stream_rate_hz
    low_hz, high_hz = max(0.5 * plan.low_hz, 0.5 * rate_hz / length), min(ABOVE * plan.high_hz, 0.49 * rate_hz)
    if not (low_hz < high_hz and plan.low_hz < min(plan.high_hz, 0.5 * rate_hz)):
        if not plan.low_hz < plan.high_hz:
            problem = f"low_hz must be < high_hz = {plan.high_hz:g} Hz, got {plan.low_hz:g} Hz"
        elif not plan.low_hz < 0.5 * rate_hz:
            problem = f"low_hz must be < {0.5 * rate_hz:g} Hz, half of the sample rate, got {plan.low_hz:g} Hz"
        else:
            problem = (
                f"high_hz must be > {low_hz / ABOVE:.4g} Hz for this length of the signal, got {plan.high_hz:g} Hz; "
                "raise high_hz or identify_s"
            )
        raise ConfigError(problem)
    excitation = Excitation(
        kind=PSEUDO,
        frames=FRAMES,
        frame_s=length / rate_hz,
        rms=plan.identify_rms,
        seed=plan.seed,
        low_hz=low_hz,
        high_hz=high_hz,
    )
    drive = excitation.samples(rate_hz)
    rest = round(plan.rest_s * rate_hz)
    read = complete(hardware.respond(drive, rest), len(drive) + rest)
    frequency: Real = np.asarray(np.fft.rfftfreq(length, 1.0 / rate_hz), np.float64)
    rise = np.clip((frequency - low_hz) / max(0.5 * plan.low_hz, 1e-9), 0.0, 1.0)
    fall = np.clip((high_hz - frequency) / (0.25 * plan.high_hz), 0.0, 1.0)
    edge = np.sin(0.5 * np.pi * np.minimum(rise, fall)) ** 2
    inside = edge > 0.0
    x = np.fft.rfft(drive[:length])
    if plan.low_hz == 0.0:  # the static response is that of the springs, as on the lowest line
        edge[0], inside[0], x[0] = 1.0, True, abs(x[1])
    functions = []
    for response in (plan.response, Response.SUPERIOR):
        found = response.of(read, calibration, 0.5 * rate_hz)[length : len(drive)]
        frames = np.fft.rfft(found.reshape(FRAMES, length))
        h, inverse = np.zeros((2, len(frequency)), np.complex128)
        h[inside] = frames.mean(axis=0)[inside] / x[inside]
        if plan.low_hz == 0.0:
            h[0] = abs(h[1])
        # the part that does not repeat is noise, similar on neighbouring lines: where it hides H, little is corrected
        noise = np.convolve(frames.var(axis=0, ddof=1) / FRAMES, np.full(BESIDE, 1.0 / BESIDE), "same")
        floor = noise[inside] / np.abs(x[inside]) ** 2
        inverse[inside] = edge[inside] * np.conj(h[inside]) / (np.abs(h[inside]) ** 2 + NOISES * floor)
        functions.append((h, inverse))
    return functions


STEP_S = 1.0  # rig time between two results of `play` [s]


@attrs.frozen(eq=False, kw_only=True)
class Played:
    """Part of a time history that `play` has sent to the drive so far, and the scans measured during it."""

    rate_hz: int  # number of samples, and of scans, per second
    asked: Real  # samples that were played, after clipping, shape (n,); A, m or V by `drive.kind`
    rows: NDArray[np.void]  # rows of `daq/scan`, shape (n,): one scan per sample
    whole: int  # total number of samples of the history
    clipped: int  # number of samples of the whole history that exceeded the limit and were clipped

    @property
    def error(self) -> float:
        """Standard deviation of measured current − played samples, divided by that of the played samples.

        It is NaN if the samples are constant, and meaningful only if the history is a current.
        """
        apart, asked = (self.rows["current"] - self.asked).std(), self.asked.std()
        return float(apart / asked) if asked > 0.0 else math.nan

    def kurtosis(self, name: str) -> float:
        """Return the kurtosis of the scans of a channel so far: 1.5 for a sine, 3 for Gaussian noise.

        Args:
            name: name of the channel, such as "base".
        """
        return float(scipy.stats.kurtosis(self.rows[name].astype(float), fisher=False))


def play(hardware: Hardware, samples: Real, limit: float | None = None) -> Iterator[Played]:
    """Play a time history unchanged through the drive, and measure all channels meanwhile.

    Args:
        hardware: output and acquisition, with equal rates.
        samples: the history, A, m or V by `drive.kind`, shape (n,).
        limit: absolute value to which larger samples are clipped; None means that none is clipped. The rig rejects
            samples beyond the range of its shaker.

    Yields:
        The part played so far, once per second of rig time and at the end. The drive is stopped after the last result.
        After an error, or if you do not iterate to the end, call `hardware.output.stop()`.

    Raises:
        CommandError: the shaker trips or rejects a sample, samples arrive too late, scans are lost, or a reading
            exceeds `abort` of `hardware`.
        TimeoutError: the rig did not advance.
    """
    rate_hz = hardware.rig.stream_rate_hz
    asked = samples if limit is None else np.clip(samples, -limit, limit)
    clipped = int(np.count_nonzero(asked != samples))
    step = max(1, round(STEP_S * rate_hz))
    exchange = Exchange(hardware, step)
    coming, rows = np.concatenate([asked, np.zeros(exchange.lag)]), np.empty(0, np.void)
    for at in range(0, len(coming), step):
        block = coming[at : at + step]
        part = complete(exchange.exchange(block)[1], len(block))
        rows = rows if len(rows) else np.empty(len(coming), part.dtype)
        rows[at : at + step] = part
        done = min(at + step, len(coming)) - exchange.lag
        if done > 0:
            scans = rows[exchange.lag : exchange.lag + done]
            yield Played(rate_hz=rate_hz, asked=asked[:done], rows=scans, whole=len(asked), clipped=clipped)
    hardware.output.stop()
