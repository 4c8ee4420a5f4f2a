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
"""Frequency response of a rig to its current: burst random, pseudo-random or chirp, frame by frame, with coherence.

Every response is the motion, not the reading: lag, skew, high-pass and order of derivative of its sensor are corrected
by its calibration (`motion`).

A burst fills the first part of a frame and has decayed at its end; a pseudo-random frame or a chirp repeats. Nothing
leaks, so no window is needed. For a rig with its sphere this is the best linear approximation at this level: the
missing coherence is noise and distortion (Pintelon & Schoukens 2012, System Identification, chapter 4).
"""

from __future__ import annotations

import enum
from collections.abc import Iterator

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Calibration, Real
from impact_rig.analysis.frf import Frf, frf
from impact_rig.analysis.scans import CHANNELS
from impact_rig.driver.hardware import Exchange, Hardware
from impact_rig_studies.excitation.signals import Excitation


class Response(enum.StrEnum):
    """Controllable response: the reading of a channel, or its second derivative."""

    BASE = "base"
    SUPERIOR = "superior"
    BASE_ACCELERATION = "base_acceleration"
    SUPERIOR_ACCELERATION = "superior_acceleration"

    @property
    def channel(self) -> str:
        """Channel that measures it."""
        return {"superior": "laser", "superior_acceleration": "accelerometer"}.get(self, "base")

    @property
    def unit(self) -> str:
        """SI unit."""
        return "m/s²" if self.endswith("acceleration") else "m"

    @property
    def channel_index(self) -> int:
        """Index of that channel in `scans.CHANNELS`."""
        return CHANNELS.index(self.channel)

    def of(self, rows: NDArray[np.void], calibration: Calibration, top_hz: float) -> Real:
        """Return the motion that the channel measured up to a frequency, shape (n,)."""
        return motion(rows[self.channel].astype(float), calibration, self.channel_index, top_hz)

    def weight(self, calibration: Calibration, frequency_hz: Real) -> Real:
        """Return the factor from the density of the channel to that of the response."""
        power = 4 if self is Response.BASE_ACCELERATION else 0
        seen = np.abs(calibration.response(self.channel_index, frequency_hz))
        return np.asarray((2.0 * np.pi * frequency_hz) ** power / seen**2)

    def noise(self, calibration: Calibration, frequency_hz: Real) -> Real:
        """Return the density of the sensor's own noise, white over the bandwidth of the scans."""
        white = 2.0 * _white_rms(calibration, self.channel_index) ** 2 / calibration.rate_hz
        return np.asarray(self.weight(calibration, frequency_hz) * white)

    def noises(self, calibration: Calibration, length: int, count: int, top_hz: float) -> Real:
        """Return simulated sensor noise as motion at rest up to a frequency, shape (count, length)."""
        drawn = np.random.default_rng(0).normal(0.0, _white_rms(calibration, self.channel_index), (count, length))
        return np.array([motion(one, calibration, self.channel_index, top_hz) for one in drawn])


def _white_rms(calibration: Calibration, channel: int) -> float:
    """Return the rms of white noise with the density of a channel near 0 Hz."""
    return float(calibration.noise[channel] * np.sqrt(calibration.noise_crowding()[channel]))


FADE = 0.8  # fraction of a band at which its edge begins to fall


def motion(values: Real, calibration: Calibration, channel: int, top_hz: float, around: int = 0) -> Real:
    """Return the motion that a sensor measured: corrected for lag, skew, high-pass and derivative, within a band.

    Args:
        values: contiguous readings, shape (n,).
        calibration: calibration of the instruments.
        channel: index into `scans.CHANNELS`.
        top_hz: upper edge of the band; half of the rate keeps it open.
        around: number of samples mirrored at both ends if the record does not begin and end at rest.
    """
    mirrored = np.pad(values, around, mode="reflect", reflect_type="odd") if around else values
    frequency: Real = np.asarray(np.fft.rfftfreq(len(mirrored), 1.0 / calibration.rate_hz), np.float64)
    edge = np.ones(len(frequency))
    if top_hz < 0.5 * calibration.rate_hz:
        edge = np.sin(0.5 * np.pi * np.clip((top_hz - frequency) / ((1.0 - FADE) * top_hz), 0.0, 1.0)) ** 2
    response = calibration.response(channel, frequency)
    seen = (edge > 0.0) & (response != 0.0)  # a sensor with a high-pass does not measure the mean
    spectrum = np.where(seen, np.fft.rfft(mirrored) * edge, 0.0)
    spectrum[seen] /= response[seen]
    found: Real = np.fft.irfft(spectrum, len(mirrored))[around : around + len(values)]
    return found


def measure(hardware: Hardware, excitation: Excitation, channel: str, reference: str = "current") -> Iterator[Frf]:
    """Drive the rig and yield channel / reference after each frame from the third on.

    Lag, skew and high-pass of the sensors are corrected by their calibration.

    Args:
        hardware: output and acquisition, with equal rates.
        excitation: the drive.
        channel: channel of the response.
        reference: channel of the excitation.

    Raises:
        ConfigError: the band does not fit the rate.
        CommandError: the shaker trips, or rejects the drive.
        TimeoutError: the rig did not advance.
    """
    rate_hz = hardware.rig.rate_hz
    samples, length = excitation.samples(rate_hz), round(excitation.frame_s * rate_hz)
    calibration = Calibration.from_info(hardware.info())
    x, y = CHANNELS.index(reference), CHANNELS.index(channel)
    gain = np.hypot(calibration.gain_uncertainty[x], calibration.gain_uncertainty[y])
    exchange = Exchange(hardware, length)
    settling = len(samples) - excitation.frames * length + exchange.lag
    samples = np.concatenate([samples, np.zeros(exchange.lag)])
    read = {name: np.empty(0) for name in (reference, channel)}
    for at in range(0, len(samples), length):
        rows = exchange.exchange(samples[at : at + length])[1]
        read = {name: np.concatenate([before, rows[name]]) for name, before in read.items()}
        frames = (len(read[channel]) - settling) // length
        if frames < 3:
            continue
        part = slice(settling, settling + frames * length)
        found = frf(read[reference][part], read[channel][part], rate_hz, length, overlap=0.0, window="boxcar")
        with np.errstate(divide="ignore", invalid="ignore"):  # a high-pass hides the mean
            lag = calibration.response(x, found.frequency_hz) / calibration.response(y, found.frequency_hz)
        lag[~np.isfinite(lag)] = 0.0
        if reference == "current":
            # straight lines between samples: scans at the samples fold their harmonics onto it
            lag = lag / np.sinc(found.frequency_hz / rate_hz) ** 2
        lines = found.frequency_hz[found.excited]
        # other lines contain only leakage through the edges
        inside = (lines >= excitation.low_hz) & (lines <= excitation.high_hz)
        yield attrs.evolve(
            found, h1=found.h1 * lag, h2=found.h2 * lag, hv=found.hv * lag, u_relative=np.hypot(found.u_relative, gain),
            excited=found.excited[inside] if inside.any() else found.excited,
        )  # fmt: skip
    hardware.output.stop()
