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
"""Time histories: played as they are, or a response is made to follow one by iterative learning.

    drive_1 = F⁻¹ [X / H],    drive_{n+1} = drive_best + g F⁻¹ [(X − Y_best) / H]

g is 1 and halves after each trial that is worse than the best one: with a sphere the response is not linear.

A response is the motion, not the reading: what is known of its sensor is undone (`response.motion`), and it is judged
in the band that is controlled. What the sensor's noise in that band and the uncertainty of its gain leave open is the
floor of an error.

H is measured first, on the lines of a frame that repeats: longer than the structure rings, since 1 / H rings as long
where the structure holds the base still. A trial begins and ends at rest and is corrected on those same lines.
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
from impact_rig_studies.excitation.response import PSEUDO, Excitation, Response

LEAST_GAIN = 0.2  # a trial that is worse with a smaller gain than this ends the learning

ABOVE = 1.25  # times the upper edge of the band, where the correction has faded out
FRAMES = 3  # of the identification; one more goes ahead
BESIDE = 25  # lines over which the noise of a response function is averaged
NOISES = 4.0  # times its variance by which |H|² is held away from zero


@attrs.frozen(kw_only=True)
class ReplicatePlan:
    """How a history is replicated.

    Attributes:
        low_hz: lower edge of the band in which the drive is corrected; 0: down to rest itself.
        high_hz: its upper edge.
        iterations: at the most, the first trial included.
        enough: relative error at which it is good enough.
        rest_s: at rest before and after the history [s].
        identify_rms: of the drive while the response function is estimated [A].
        identify_s: length of the frame [s]; four are played.
        response: what follows, of `RESPONSES`.
        seed: of its random numbers.
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
    """A history and what followed it, in the best trial so far."""

    rate_hz: int  # samples per second
    asked: Real  # shape (n,)
    reached: Real  # shape (n,), within the band that is controlled
    linear: Real
    """What the drive would have given by H alone, shape (n,): where `reached` departs, the rig is not linear, or its
    sensors are noisy."""
    drive: Real  # of the whole trial, shape (m,) [A]
    lead: int  # samples of it before the history
    errors: tuple[float, ...]  # rms error over rms of what was asked, trial by trial
    floor: float
    """What of such an error the sensor's noise and twice the standard uncertainty of its gain may account for."""

    def relative(self, rest: Real) -> float:
        """Return the rms of a difference over that of what was asked."""
        return float(np.sqrt(np.mean(rest**2) / np.mean(self.asked**2)))


def replicate(hardware: Hardware, asked: Real, plan: ReplicatePlan) -> Iterator[Replicated]:
    """Make a response follow a history; yields after each trial.

    Args:
        hardware: output and acquisition, of one rate.
        asked: the history, in the unit of the response; it begins and ends near zero; shape (n,).
        plan: how.

    Raises:
        CommandError: the shaker trips, or refuses the drive.
        TimeoutError: the rig did not go on.
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
    fade *= fade[::-1]  # at rest where a trial begins and ends, also of what an offset would have corrected
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
    """Return H and, with soft edges of the band, 1 / H on the lines of a frame of so many samples."""
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
    # what does not repeat is noise, about the same on lines side by side: where it hides H, little is corrected
    noise = np.convolve(frames.var(axis=0, ddof=1) / FRAMES, np.full(BESIDE, 1.0 / BESIDE), "same")
    if plan.low_hz == 0.0:  # at rest the springs answer, as on the lowest line
        edge[0], inside[0], x[0], h[0] = 1.0, True, abs(x[1]), abs(h[1])
    floor = noise[inside] / np.abs(x[inside]) ** 2
    inverse[inside] = edge[inside] * np.conj(h[inside]) / (np.abs(h[inside]) ** 2 + NOISES * floor)
    return h, inverse


STEP_S = 1.0


@attrs.frozen(eq=False, kw_only=True)
class Played:
    """What was played so far."""

    rate_hz: int  # samples per second, and scans
    asked: Real  # shape (n,), A, m or V by `drive.kind`
    rows: NDArray[np.void]  # of `daq/scan`, shape (n,): a scan a sample
    whole: int  # samples of the history
    clipped: int  # samples of it that were clipped

    @property
    def error(self) -> float:
        """Rms of the current less what was asked, without its mean, over the rms asked; NaN if that is 0."""
        apart, asked = (self.rows["current"] - self.asked).std(), self.asked.std()
        return float(apart / asked) if asked > 0.0 else math.nan

    def kurtosis(self, name: str) -> float:
        """Return that of a channel: 1.5 of a sine, 3 of Gaussian noise."""
        return float(scipy.stats.kurtosis(self.rows[name].astype(float), fisher=False))


def play(hardware: Hardware, samples: Real, limit: float | None = None) -> Iterator[Played]:
    """Play samples; yields what was played so far once a second of it, and at its end.

    Args:
        hardware: output and acquisition, of one rate.
        samples: A, m or V by `drive.kind`, shape (n,).
        limit: samples are clipped there, either side; None: the rig refuses what is beyond the shaker.

    Raises:
        CommandError: the shaker trips, or refuses a sample.
        TimeoutError: the rig did not go on.
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
