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
"""Measurement of a frequency response (`measure`), and the responses that excitation tests control (`Response`).

The rig is driven by frames of noise or chirps (`signals.Excitation`). Each further frame makes the frequency response
more accurate. A burst of noise decays before its frame ends, and other frames are repeated. So there is no leakage, and
no window is needed. For a rig with its sphere, the result is the best linear approximation at this level of excitation.
A coherence below 1 is then caused by noise and distortion (Pintelon & Schoukens 2012, System Identification, chapter
4).

Every response is the motion of the rig, not the reading of the sensor: `motion` corrects the reading by the sensor's
calibration.
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
from impact_rig.errors import CommandError
from impact_rig_studies.excitation.signals import Excitation


class Response(enum.StrEnum):
    """Response of the rig that a test can control: displacement or acceleration of the inferior or superior base."""

    BASE = "base"
    SUPERIOR = "superior"
    BASE_ACCELERATION = "base_acceleration"
    SUPERIOR_ACCELERATION = "superior_acceleration"

    @property
    def channel(self) -> str:
        """Name of the channel of `daq/scan` from which this response is computed."""
        return {"superior": "laser", "superior_acceleration": "accelerometer"}.get(self, "base")

    @property
    def unit(self) -> str:
        """SI unit of this response: m or m/s²."""
        return "m/s²" if self.endswith("acceleration") else "m"

    @property
    def channel_index(self) -> int:
        """Index in `scans.CHANNELS` of the channel that measures this response."""
        return CHANNELS.index(self.channel)

    def of(self, rows: NDArray[np.void], calibration: Calibration, top_hz: float) -> Real:
        """Return the motion that the channel of this response measured, corrected as in `motion`, shape (n,).

        The unit is `unit`, with one exception: `BASE_ACCELERATION` gives the displacement [m], because only its spectra
        are converted to an acceleration (`weight`).

        Args:
            rows: consecutive rows of `daq/scan`, shape (n,).
            calibration: calibration of the sensors.
            top_hz: upper edge of the band to which the motion is limited, see `motion`.
        """
        return motion(rows[self.channel].astype(float), calibration, self.channel_index, top_hz)

    def weight(self, calibration: Calibration, frequency_hz: Real) -> Real:
        """Return the factors that convert the power spectral density of the channel's reading to that of this response.

        The factor removes the frequency response of the sensor. For `BASE_ACCELERATION` it also turns displacement into
        acceleration.

        Args:
            calibration: calibration of the sensors.
            frequency_hz: frequencies, shape (n,), > 0; the factors have the same shape.
        """
        power = 4 if self is Response.BASE_ACCELERATION else 0
        seen = np.abs(calibration.response(self.channel_index, frequency_hz))
        return np.asarray((2.0 * np.pi * frequency_hz) ** power / seen**2)

    def noise(self, calibration: Calibration, frequency_hz: Real) -> Real:
        """Return the power spectral density of the sensor's noise, converted to this response, in its unit² / Hz.

        The sensor's noise is assumed to be white up to half of the scan rate.

        Args:
            calibration: calibration of the sensors.
            frequency_hz: frequencies, shape (n,), > 0; the density has the same shape.
        """
        white = 2.0 * _white_rms(calibration, self.channel_index) ** 2 / calibration.rate_hz
        return np.asarray(self.weight(calibration, frequency_hz) * white)

    def noises(self, calibration: Calibration, length: int, count: int, top_hz: float) -> Real:
        """Return simulated records of the apparent motion that the sensor's noise alone causes on a rig at rest.

        Args:
            calibration: calibration of the sensors.
            length: number of samples of a record.
            count: number of records; each call returns the same records.
            top_hz: upper edge of the band, see `motion`.

        Returns:
            The records in the unit of the motion, shape (count, length).
        """
        drawn = np.random.default_rng(0).normal(0.0, _white_rms(calibration, self.channel_index), (count, length))
        return np.array([motion(one, calibration, self.channel_index, top_hz) for one in drawn])


def _white_rms(calibration: Calibration, channel: int) -> float:
    """Return the rms of white noise that has the same density as a channel's noise near 0 Hz.

    The white noise extends up to half of the scan rate.

    Args:
        calibration: calibration of the sensors.
        channel: index of the channel in `scans.CHANNELS`.
    """
    return float(calibration.noise[channel] * np.sqrt(calibration.noise_crowding()[channel]))


FADE = 0.8  # fraction of the upper band edge from which components are attenuated, down to zero at the edge


def motion(values: Real, calibration: Calibration, channel: int, top_hz: float) -> Real:
    """Return the motion that a sensor measured: its reading, corrected for lag, skew and high-pass of the sensor.

    For the channels of the bases the motion is the displacement [m]: the reading of a sensor of velocity or
    acceleration is integrated. For the channel "accelerometer" the motion is the acceleration [m/s²]. Frequencies above
    `top_hz` are removed, because the correction amplifies noise.

    Args:
        values: contiguous readings of a channel, which begin and end at rest, shape (n,).
        calibration: calibration of the sensors.
        channel: index of the channel in `scans.CHANNELS`.
        top_hz: upper edge of the band. Components fade out from `FADE` · `top_hz`, and are zero above `top_hz`. If
            `top_hz` is at least half of the scan rate, no high frequencies are removed. The mean of a sensor with a
            high-pass is always removed.
    """
    frequency: Real = np.asarray(np.fft.rfftfreq(len(values), 1.0 / calibration.rate_hz), np.float64)
    edge = np.ones(len(frequency))
    if top_hz < 0.5 * calibration.rate_hz:
        edge = np.sin(0.5 * np.pi * np.clip((top_hz - frequency) / ((1.0 - FADE) * top_hz), 0.0, 1.0)) ** 2
    response = calibration.response(channel, frequency)
    seen = (edge > 0.0) & (response != 0.0)  # a sensor with a high-pass does not measure the mean
    spectrum = np.where(seen, np.fft.rfft(values) * edge, 0.0)
    spectrum[seen] /= response[seen]
    found: Real = np.fft.irfft(spectrum, len(values))
    return found


def complete(scans: NDArray[np.void], count: int) -> NDArray[np.void]:
    """Return the scans of a test unchanged, after a check that all `count` expected scans are there.

    Raises:
        CommandError: scans were lost, so the other scans no longer belong to the samples that were played.
    """
    if len(scans) < count:
        raise CommandError(
            f"{count - len(scans)} of {count} scans were lost, but this test needs every scan: repeat it with less "
            "load on the machine, or remove the fault that withholds scans"
        )
    return scans


def measure(hardware: Hardware, excitation: Excitation, channel: str, reference: str = "current") -> Iterator[Frf]:
    """Measure the frequency response of one channel relative to another while driving the rig with an excitation.

    The calibration of the sensors corrects their lag, skew and high-pass. The channels of the bases count as
    displacements, also if their sensors measure velocity or acceleration. The uncertainty `u_relative` includes the
    uncertainty of the sensors' gains.

    Args:
        hardware: output and acquisition, with equal rates.
        excitation: signal that drives the rig.
        channel: name of the channel of the response (numerator).
        reference: name of the channel of the reference (denominator).

    Yields:
        The frequency response from all frames measured so far. The first result follows after three frames, then one
        after each frame. The drive is stopped after the last one. After an error, or if you do not iterate to the end,
        call `hardware.output.stop()`.

    Raises:
        ConfigError: the band of the excitation is not ascending, or not below half of the sample rate. Or a frame,
            or the burst in it, is too short.
        BudgetError: the excitation would have too many samples.
        CommandError: the shaker trips or rejects the drive, samples arrive too late, scans are lost, or a reading
            exceeds `abort` of `hardware`.
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
        frame = samples[at : at + length]
        rows = complete(exchange.exchange(frame)[1], len(frame))
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
            found,
            h1=found.h1 * lag,
            h2=found.h2 * lag,
            hv=found.hv * lag,
            u_relative=np.hypot(found.u_relative, gain),
            excited=found.excited[inside] if inside.any() else found.excited,
        )
    hardware.output.stop()
