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

The gain g is 1 and halves after each trial that is worse than the best one: with a sphere the response is not linear.

A response is the motion, not the reading: the known behaviour of its sensor is corrected (`response.motion`). The error
is judged in the controlled band. The floor of the error is what the sensor's noise in that band and the uncertainty of
its gain can explain.

H is measured first, at the frequency lines of a repeated frame. The frame must be longer than the structure takes to
stop ringing, since the impulse response of 1 / H is as long at an antiresonance of the base. A trial begins and ends at
rest and is corrected at the same lines.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Calibration, Complex, Real
from impact_rig.driver.hardware import Exchange, Hardware
from impact_rig_studies.excitation.response import Response
from impact_rig_studies.excitation.signals import PSEUDO, Excitation

LEAST_GAIN = 0.2  # gain of a correction, below which the trials end

ABOVE = 1.25  # frequency at which the correction has faded out, as a multiple of the upper band edge
FRAMES = 3  # number of measured frames of the identification of H; one more precedes them
BESIDE = 25  # number of frequency lines over which the noise of H is averaged
NOISES = 4.0  # multiple of the variance of H's noise that is added to |H|² where it divides


@attrs.frozen(kw_only=True)
class ReplicatePlan:
    """Settings of the replication of a time history by a response of the rig.

    Attributes:
        low_hz: lower edge of the band in which the drive is corrected; 0 includes the static value.
        high_hz: upper edge of that band.
        iterations: maximum number of trials, including the first.
        enough: rms error over the rms of the requested history at which the trials end.
        rest_s: time without drive before and after the history in each trial [s].
        identify_rms: rms of the drive while the response function is measured [A].
        identify_s: time by which a frame of that measurement is longer than a trial [s]; four frames are played.
        response: response that follows the history, one of `Response`.
        seed: seed of the random phases of that measurement.
    """

    low_hz: float = attrs.field(default=2.0, validator=attrs.validators.ge(0.0))
    high_hz: float = attrs.field(default=150.0, validator=attrs.validators.gt(0.0))
    iterations: int = attrs.field(default=10, validator=attrs.validators.ge(1))
    enough: float = attrs.field(default=0.005, validator=attrs.validators.ge(0.0))
    rest_s: float = attrs.field(default=2.0, validator=attrs.validators.gt(0.0))
    identify_rms: float = attrs.field(default=2.0, validator=attrs.validators.gt(0.0))
    identify_s: float = attrs.field(default=32.0, validator=attrs.validators.gt(0.0))
    response: Response = attrs.field(default=Response.BASE, converter=Response)
    seed: int = 1


@attrs.frozen(eq=False, kw_only=True)
class Replicated:
    """Result of a replication after a trial: requested history, and drive and response of the best trial so far."""

    rate_hz: int  # samples per second
    asked: Real  # requested history in the SI unit of the response, shape (n,)
    reached: Real  # measured response of the best trial below the upper band edge, likewise
    linear: Real
    """Response that the measured H predicts for the drive of the best trial, likewise.

    If `reached` differs, the rig is not linear, or its sensors are noisy.
    """
    drive: Real  # drive of the whole best trial, with the rest before and after the history, shape (m,) [A]
    lead: int  # number of samples in `drive` before the history
    errors: tuple[float, ...]  # rms error over rms of the requested history, for each trial so far
    floor: float
    """Value of such an error that the sensor's noise and twice the standard uncertainty of its gain can explain."""

    def relative(self, rest: Real) -> float:
        """Return the rms of a difference from the requested history, divided by the rms of that history.

        Args:
            rest: difference in the unit of the history, such as `reached − linear`, shape (n,).
        """
        return float(np.sqrt(np.mean(rest**2) / np.mean(self.asked**2)))


def replicate(hardware: Hardware, asked: Real, plan: ReplicatePlan) -> Iterator[Replicated]:
    """Make a response of the rig follow a time history by correcting the drive in trials.

    Args:
        hardware: output and acquisition, with equal rates.
        asked: the history in the SI unit of the response, shape (n,); it begins and ends near zero.
        plan: settings.

    Yields:
        After each trial the best result so far, with the errors of all trials. They end when the error is small enough,
        when corrections no longer improve it, or after the maximum number.

    Raises:
        CommandError: the shaker trips, or rejects the drive.
        TimeoutError: the rig did not advance.
    """
    rate_hz = hardware.rig.stream_rate_hz
    lead = round(plan.rest_s * rate_hz)
    played = len(asked) + 2 * lead
    length = played + round(plan.identify_s * rate_hz)
    target = np.zeros(length)
    history = slice(lead, lead + len(asked))
    target[history] = asked
    calibration = Calibration.from_info(hardware.info())
    h, inverse = _identify(hardware, plan, length, calibration)
    drive = np.fft.irfft(inverse * np.fft.rfft(target), length)
    fade = np.sin(0.5 * np.pi * np.clip(4.0 * np.arange(played) / max(1, lead) - 2.0, 0.0, 1.0)) ** 2
    fade *= fade[::-1]  # at rest where a trial begins and ends, including the correction of an offset
    top_hz = min(ABOVE * plan.high_hz, 0.5 * rate_hz)
    noise = float(plan.response.noises(calibration, len(asked), 1, top_hz).std() / np.sqrt(np.mean(asked**2)))
    floor = math.hypot(noise, 2.0 * float(calibration.gain_uncertainty[plan.response.channel_index]))
    errors: list[float] = []
    best: Replicated | None = None
    gain, correction = 1.0, np.zeros(length)
    for _ in range(plan.iterations):
        drive[:played] *= fade
        drive[played:] = 0.0
        found = plan.response.of(hardware.respond(drive[:played]), calibration, top_hz)
        found = found - found[lead // 4 : max(1, lead // 2)].mean()
        miss = np.zeros(length)
        miss[:played] = fade * (target[:played] - found)
        errors.append(float(np.sqrt(np.mean(miss[history] ** 2) / np.mean(asked**2))))
        improves = best is None or errors[-1] <= min(errors)
        if improves:
            correction = np.fft.irfft(inverse * np.fft.rfft(miss), length)
            linear = np.fft.irfft(h * np.fft.rfft(drive), length)[history]
            best = Replicated(
                rate_hz=rate_hz, asked=asked, reached=found[history], linear=linear, drive=drive[:played].copy(),
                lead=lead, errors=(), floor=floor,
            )  # fmt: skip
        assert best is not None
        yield attrs.evolve(best, errors=tuple(errors))
        gain = gain if improves else 0.5 * gain
        if errors[-1] <= plan.enough or gain < LEAST_GAIN:
            break
        drive = np.concatenate([best.drive, np.zeros(length - played)]) + gain * correction


def _identify(
    hardware: Hardware, plan: ReplicatePlan, length: int, calibration: Calibration
) -> tuple[Complex, Complex]:
    """Measure the response function H from the drive to the response by playing pseudo-random noise.

    Args:
        hardware: output and acquisition.
        plan: settings, with the band, the response and the level of the noise.
        length: number of samples of a frame, which defines the frequency lines.
        calibration: calibration of the sensors.

    Returns:
        H, and 1 / H faded out at the edges of the band and reduced where noise hides H; each at the lines of
        `numpy.fft.rfft`, and 0 outside of the band.
    """
    rate_hz = hardware.rig.stream_rate_hz
    low_hz, high_hz = max(0.5 * plan.low_hz, 0.5 * rate_hz / length), min(ABOVE * plan.high_hz, 0.49 * rate_hz)
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
    read = hardware.respond(drive, round(plan.rest_s * rate_hz))
    found = plan.response.of(read, calibration, 0.5 * rate_hz)[: len(drive)]
    frequency: Real = np.asarray(np.fft.rfftfreq(length, 1.0 / rate_hz), np.float64)
    rise = np.clip((frequency - low_hz) / max(0.5 * plan.low_hz, 1e-9), 0.0, 1.0)
    fall = np.clip((high_hz - frequency) / (0.25 * plan.high_hz), 0.0, 1.0)
    edge = np.sin(0.5 * np.pi * np.minimum(rise, fall)) ** 2
    inside = edge > 0.0
    x, frames = np.fft.rfft(drive[:length]), np.fft.rfft(found[length:].reshape(FRAMES, length))
    h, inverse = np.zeros((2, len(frequency)), np.complex128)
    h[inside] = frames.mean(axis=0)[inside] / x[inside]
    # the part that does not repeat is noise, similar on neighbouring lines: where it hides H, little is corrected
    noise = np.convolve(frames.var(axis=0, ddof=1) / FRAMES, np.full(BESIDE, 1.0 / BESIDE), "same")
    if plan.low_hz == 0.0:  # the static response is that of the springs, as on the lowest line
        edge[0], inside[0], x[0], h[0] = 1.0, True, abs(x[1]), abs(h[1])
    floor = noise[inside] / np.abs(x[inside]) ** 2
    inverse[inside] = edge[inside] * np.conj(h[inside]) / (np.abs(h[inside]) ** 2 + NOISES * floor)
    return h, inverse


STEP_S = 1.0  # rig time between two results of `play` [s]


@attrs.frozen(eq=False, kw_only=True)
class Played:
    """Part of a time history that has been played unchanged so far, and the scans measured during it."""

    rate_hz: int  # number of samples, and of scans, per second
    asked: Real  # samples that were played, after clipping, shape (n,); A, m or V by `drive.kind`
    rows: NDArray[np.void]  # rows of `daq/scan`, shape (n,): one scan per sample
    whole: int  # total number of samples of the history
    clipped: int  # number of samples of the whole history that exceeded the limit and were clipped

    @property
    def error(self) -> float:
        """Standard deviation of measured current − played samples, over that of the samples; NaN if those are constant.

        It is meaningful only if the history is a current.
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
        limit: absolute value at which samples are clipped; None means that none is clipped, and that the rig rejects
            samples beyond the range of its shaker.

    Yields:
        The part played so far, once per second of rig time and at the end.

    Raises:
        CommandError: the shaker trips, or rejects a sample.
        TimeoutError: the rig did not advance.
    """
    rate_hz = hardware.rig.stream_rate_hz
    asked = samples if limit is None else np.clip(samples, -limit, limit)
    clipped = int(np.count_nonzero(asked != samples))
    step = max(1, round(STEP_S * rate_hz))
    exchange = Exchange(hardware, step)
    coming, rows = np.concatenate([asked, np.zeros(exchange.lag)]), np.empty(0, np.void)
    for at in range(0, len(coming), step):
        part = exchange.exchange(coming[at : at + step])[1]
        rows = rows if len(rows) else np.empty(len(coming), part.dtype)
        rows[at : at + step] = part
        done = min(at + step, len(coming)) - exchange.lag
        if done > 0:
            scans = rows[exchange.lag : exchange.lag + done]
            yield Played(rate_hz=rate_hz, asked=asked[:done], rows=scans, whole=len(asked), clipped=clipped)
    hardware.output.stop()
