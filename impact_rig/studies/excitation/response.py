# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Frequency response of a rig to its current: burst random, pseudo-random or chirp, frame by frame, with coherence.

A burst fills the first part of a frame and has died away at its end, a pseudo-random frame or a chirp repeats: nothing
leaks, so no window is needed. Of a rig with its sphere this is the best linear approximation at this level: what the
coherence lacks is noise and distortion (Pintelon & Schoukens 2012, System Identification, chapter 4).
"""

from __future__ import annotations

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy import signal

from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.frf import Frf, frf
from impact_rig.errors import ConfigError
from impact_rig.operate.hardware import Hardware

Real = NDArray[np.float64]
BURST, PSEUDO, CHIRP = KINDS = ("burst_random", "pseudo_random", "chirp")
CHANNELS = ("accelerometer", "laser", "base", "current")
"""In the order of `analysis.channels`."""


@attrs.frozen(kw_only=True)
class Excitation:
    """What drives the rig for a frequency response.

    Attributes:
        kind: one of `KINDS`.
        frames: that are measured; of a repeated one, one more goes ahead.
        frame_s: length of a frame [s].
        burst: share of a frame that a burst fills.
        low_hz: lower edge of the band.
        high_hz: upper edge.
        rms: of the drive while it is on [A].
        seed: of its random numbers.
    """

    kind: str = attrs.field(default=BURST, validator=attrs.validators.in_(KINDS))
    frames: int = attrs.field(default=20, validator=attrs.validators.ge(2))
    frame_s: float = attrs.field(default=8.0, validator=attrs.validators.gt(0.0))
    burst: float = attrs.field(default=0.5, validator=[attrs.validators.gt(0.0), attrs.validators.le(1.0)])
    low_hz: float = attrs.field(default=4.0, validator=attrs.validators.gt(0.0))
    high_hz: float = attrs.field(default=60.0, validator=attrs.validators.gt(0.0))
    rms: float = attrs.field(default=0.2, validator=attrs.validators.gt(0.0))
    seed: int = 1

    def samples(self, rate_hz: int) -> Real:
        """Return all frames one after the other, shape (n,)."""
        length, random = round(self.frame_s * rate_hz), np.random.default_rng(self.seed)
        if not self.low_hz < self.high_hz < 0.5 * rate_hz:
            raise ConfigError(
                f"the band must be within 0 to {0.5 * rate_hz:g} Hz, got {self.low_hz:g} to {self.high_hz:g}"
            )
        if self.kind == BURST:
            on = round(self.burst * length)
            sections = signal.butter(4, (self.low_hz, self.high_hz), "bandpass", fs=rate_hz, output="sos")
            fade = signal.windows.tukey(on, 0.1)
            frames = np.zeros((self.frames, length))
            frames[:, :on] = fade * signal.sosfilt(sections, random.standard_normal((self.frames, 2 * on)))[:, on:]
            frames *= self.rms / np.sqrt(np.mean(frames[:, :on] ** 2))
            return frames.ravel()
        if self.kind == PSEUDO:
            lines = np.fft.rfftfreq(length, 1.0 / rate_hz)
            inside = (lines >= self.low_hz) & (lines <= self.high_hz)
            frame = np.fft.irfft(inside * np.exp(2j * np.pi * random.random(len(lines))), length)
        else:
            t = np.arange(length) / rate_hz
            frame = signal.chirp(t, self.low_hz, self.frame_s, self.high_hz) * signal.windows.tukey(length, 0.05)
        return np.tile(frame * (self.rms / frame.std()), self.frames + 1)


def measure(
    hardware: Hardware, info: NDArray[np.void], excitation: Excitation, channel: str, reference: str = "current"
) -> Frf:
    """Drive the rig and return channel / reference, lag, skew and gain of the sensors corrected as calibrated.

    Args:
        hardware: output and acquisition, of one rate.
        info: rows of daq/info.
        excitation: the drive.
        channel: of the response.
        reference: of the excitation.

    Raises:
        ConfigError: the band does not fit the rate.
        TimeoutError: the rig did not go on.
    """
    rate_hz = hardware.wire.scan_rate_hz
    rows = hardware.respond(excitation.samples(rate_hz))
    length = round(excitation.frame_s * rate_hz)
    rows = rows[len(rows) - excitation.frames * length :]
    found = frf(
        rows[reference].astype(float), rows[channel].astype(float), rate_hz, length, overlap=0.0, window="boxcar"
    )
    calibration = Calibration.from_info(info)
    x, y = CHANNELS.index(reference), CHANNELS.index(channel)
    lag = calibration.response(x, found.frequency_hz) / calibration.response(y, found.frequency_hz)
    gain = np.hypot(calibration.gain_uncertainty[x], calibration.gain_uncertainty[y])
    return attrs.evolve(found, h1=found.h1 * lag, h2=found.h2 * lag, hv=found.hv * lag,
                        u_relative=np.hypot(found.u_relative, gain))  # fmt: skip
