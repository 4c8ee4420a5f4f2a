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
"""Random control: adjust a random drive until a response of the rig has the requested power spectral density.

The drive is a sum of sines at the frequency lines of a frame, with given amplitudes and random phases. Successive
frames are windowed and overlap by a half, which gives a stationary, nearly Gaussian signal. After each measurement over
some frames (a loop) the density of the drive at each line is corrected towards requested density / |H|². |H|² is the
measured density of the response, including distortion, over the density of the drive.
"""

from __future__ import annotations

from collections.abc import Iterator

import attrs
import numpy as np
import scipy

from impact_rig.analysis.calibration import Calibration, Real
from impact_rig.driver.hardware import Exchange, Hardware
from impact_rig.errors import CommandError, ConfigError
from impact_rig_studies.excitation.response import Response, complete
from impact_rig_studies.excitation.signals import check_duration

MOST_STEP_DB = 6.0  # largest change of the drive's density at a line in one loop
# lower limit of the drive's density at a line relative to the largest, so that no line is lost for good
LEAST_DRIVE_DB = -60.0


@attrs.frozen(kw_only=True)
class Spectrum:
    """Requested power spectral density, given by corners with straight lines between them on logarithmic axes.

    It is zero outside the range of the corners.
    """

    frequency_hz: tuple[float, ...]  # frequencies of the corners, ascending
    density: tuple[float, ...]  # densities at the corners, in unit of the response² / Hz

    def at(self, frequency_hz: Real) -> Real:
        """Return the density at some frequencies, in unit of the response² / Hz; 0 outside the range of the corners."""
        inside = (frequency_hz >= self.frequency_hz[0]) & (frequency_hz <= self.frequency_hz[-1])
        found = np.zeros(len(frequency_hz))
        at = np.log(frequency_hz[inside])
        found[inside] = np.exp(np.interp(at, np.log(self.frequency_hz), np.log(self.density)))
        return found


@attrs.frozen(kw_only=True)
class RandomPlan:
    """Settings of random control.

    Attributes:
        spectrum: requested power spectral density of the response.
        response: controlled response, one of `Response`.
        frame_s: length of a frame [s]; the frequency lines are 1 / frame_s apart.
        loops: number of corrections of the drive.
        frames: length of a loop in frames; spectra are averaged over it with an overlap of a half.
        averages: length of the final measurement after the last correction, in frames.
        gain: applied fraction of the computed correction in dB, up to 1.
        start_rms: rms of the drive in the first loop [A].
        crest: absolute value at which the drive is clipped, as a multiple of its rms.
        abort_db: largest allowed excess of the response over the requested density at any line [dB]; a larger one, from
            the third loop on, ends the test with an error.
        seed: seed of the random phases.
    """

    spectrum: Spectrum = Spectrum(frequency_hz=(5.0, 15.0, 200.0), density=(0.02, 0.25, 0.25))
    response: Response = attrs.field(default=Response.BASE_ACCELERATION, converter=Response)
    frame_s: float = attrs.field(default=4.0, validator=attrs.validators.gt(0.0))
    loops: int = attrs.field(default=5, validator=attrs.validators.ge(1))
    frames: int = attrs.field(default=8, validator=attrs.validators.ge(2))
    averages: int = attrs.field(default=60, validator=attrs.validators.ge(2))
    gain: float = attrs.field(default=0.8, validator=[attrs.validators.gt(0.0), attrs.validators.le(1.0)])
    start_rms: float = attrs.field(default=0.5, validator=attrs.validators.gt(0.0))
    crest: float = attrs.field(default=4.0, validator=attrs.validators.gt(1.0))
    abort_db: float = attrs.field(default=20.0, validator=attrs.validators.gt(0.0))
    seed: int = 1


@attrs.frozen(eq=False, kw_only=True)
class Reached:
    """Result of random control after one loop: requested and reached spectrum, errors, and statistics of the drive.

    Densities are in unit of the response² / Hz.
    """

    frequency_hz: Real  # frequency lines within the requested band, shape (n,)
    asked: Real  # requested density of the response at these lines, shape (n,)
    reached: Real  # density of the response measured in this loop, likewise
    noise: Real  # density of the sensor's own noise, likewise
    coherence: Real  # coherence of response and drive, shape (n,): the difference to 1 is noise and distortion
    loops: tuple[float, ...]  # rms over the lines of the error in dB, for each loop so far
    drive_rms: float  # rms of the drive in this loop [A]
    kurtosis: float  # kurtosis of the response's channel in this loop, 3 for Gaussian noise
    clipped: int  # number of clipped samples of the drive so far

    @property
    def error_db(self) -> Real:
        """Error at each frequency line: ratio of reached to requested density [dB], shape (n,)."""
        return np.asarray(10.0 * np.log10(self.reached / self.asked))

    @property
    def distortion(self) -> Real:
        """Density of the part of the response that nonlinearity of the rig causes, shape (n,).

        It is the part of the response that is not coherent with the drive, minus the noise of the sensor.
        """
        return np.maximum((1.0 - self.coherence) * self.reached - self.noise, 0.0)

    def share(self, density: Real) -> float:
        """Return the fraction of the response's mean square within the band that a part of the response contributes.

        Args:
            density: density of this part at the frequency lines, such as `distortion`, shape (n,).
        """
        return float(np.sum(density) / np.sum(self.reached))

    def within(self, bound_db: float) -> float:
        """Return the share (0 to 1) of the frequency lines whose error `error_db` is at most ±`bound_db`."""
        return float(np.mean(np.abs(self.error_db) <= bound_db))


class _Drive:
    """Generator of an endless random drive from overlapping frames with random phases.

    Args:
        length: number of samples of a frame, even.
        random: source of the phases.
    """

    def __init__(self, length: int, random: np.random.Generator) -> None:
        self._length, self._random = length, random
        self._window = np.sin(np.pi * (np.arange(length) + 0.5) / length)
        self._tail = np.zeros(length // 2)

    def samples(self, amplitude: Real, frames: int) -> Real:
        """Return the next samples of the drive [A], shape (frames · (length // 2),).

        Args:
            amplitude: peak amplitude at each frequency line of a frame [A], shape (length // 2 + 1,).
            frames: number of new frames. Each overlaps the frame before by a half, so it adds half of its length.
        """
        half = self._length // 2
        out = np.empty(frames * half)
        for k in range(frames):
            phases = np.exp(2j * np.pi * self._random.random(len(amplitude)))
            frame = self._window * np.fft.irfft(0.5 * self._length * amplitude * phases, self._length)
            out[k * half : (k + 1) * half] = self._tail + frame[:half]
            self._tail = frame[half:]
        return out


def control(hardware: Hardware, plan: RandomPlan) -> Iterator[Reached]:
    """Control the spectrum of a response by playing a random drive and correcting it after each loop.

    Args:
        hardware: output and acquisition, with equal rates.
        plan: settings.

    Yields:
        The result after each loop. The last one is the final measurement after all corrections.
        The drive is stopped after it. After an error, or if you do not iterate to the end, call
        `hardware.output.stop()`.

    Raises:
        ConfigError: a frame is too short for the rate, or for the requested spectrum.
        CommandError: the shaker trips or rejects the drive, samples arrive too late, scans are lost, a reading exceeds
            `abort` of `hardware`, or the response exceeds the request by more than `abort_db`.
        TimeoutError: the rig did not advance.
    """
    rate_hz = hardware.rig.stream_rate_hz
    check_duration("frame_s", plan.frame_s, rate_hz)
    length = 2 * round(plan.frame_s * rate_hz / 2)
    lines: Real = np.asarray(np.fft.rfftfreq(length, 1.0 / rate_hz), np.float64)
    asked = plan.spectrum.at(lines)
    band = asked > 0.0
    if plan.spectrum.frequency_hz[0] > lines[-1]:
        raise ConfigError(
            f"the requested spectrum must begin below {lines[-1]:g} Hz, half of the sample rate, got "
            f"{plan.spectrum.frequency_hz[0]:g} Hz"
        )
    if not band.any():
        raise ConfigError(
            f"frame_s must be longer: with {plan.frame_s:g} s the frequency lines are {lines[1]:g} Hz apart, and none "
            "is within the requested spectrum"
        )
    calibration = Calibration.from_info(hardware.info())
    scale = np.where(band, plan.response.weight(calibration, np.maximum(lines, lines[1])), 0.0)
    noise = plan.response.noise(calibration, lines[band])
    drive = _Drive(length, np.random.default_rng(plan.seed))
    density = band * plan.start_rms**2 / (np.count_nonzero(band) * rate_hz / length)
    exchange = Exchange(hardware, length // 2)
    errors, clipped = [], 0
    for loop in range(plan.loops + 1):
        frames = 2 * (plan.averages if loop == plan.loops else plan.frames)
        samples = drive.samples(np.sqrt(2.0 * density * rate_hz / length), frames + 4)
        drive_rms = float(np.sqrt(np.sum(density) * rate_hz / length))
        clipped += int(np.count_nonzero(np.abs(samples) > plan.crest * drive_rms))
        played, rows = exchange.exchange(np.clip(samples, -plan.crest * drive_rms, plan.crest * drive_rms))
        complete(rows, len(played))
        settled = slice(4 * (length // 2), None)  # the earlier response has decayed
        y, x = rows[plan.response.channel].astype(float)[settled], played[settled]
        options = {"fs": rate_hz, "nperseg": length, "noverlap": length // 2}
        reached, sent = scipy.signal.welch(y, **options)[1] * scale, scipy.signal.welch(x, **options)[1]
        error = 10.0 * np.log10(np.maximum(reached[band], 1e-30) / asked[band])
        errors.append(float(np.sqrt(np.mean(error**2))))
        yield Reached(
            frequency_hz=lines[band], asked=asked[band], reached=reached[band], noise=noise,
            coherence=scipy.signal.coherence(x, y, **options)[1][band], loops=tuple(errors), drive_rms=drive_rms,
            kurtosis=float(scipy.stats.kurtosis(y, fisher=False)), clipped=clipped,
        )  # fmt: skip
        if loop > 1 and error.max() > plan.abort_db:
            worst = lines[band][np.argmax(error)]
            raise CommandError(
                f"the response at {worst:g} Hz is {error.max():.1f} dB above the request, more than abort_db = "
                f"{plan.abort_db:g} dB: the test has ended; lower start_rms, request more there (noise or distortion "
                "can exceed a low request), or raise abort_db"
            )
        # relative to the frames actually sent: their deviation from the mean must not be corrected
        wanted = sent[band] * 10.0 ** (-error / 10.0) / density[band]
        step = np.clip(plan.gain * 10.0 * np.log10(wanted), -MOST_STEP_DB, MOST_STEP_DB)
        density[band] *= 10.0 ** (step / 10.0)
        density[band] = np.maximum(density[band], density.max() * 10.0 ** (LEAST_DRIVE_DB / 10.0))
    hardware.output.stop()
