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
"""Excitation signals for the measurement of a frequency response: bursts of noise, pseudo-random noise, chirps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import attrs

from impact_rig.errors import ConfigError
from impact_rig.system import budget

if TYPE_CHECKING:
    from impact_rig.analysis.calibration import Real

BURST, PSEUDO, CHIRP = KINDS = ("burst_random", "pseudo_random", "chirp")
MOST_SAMPLES = 50_000_000  # maximum number of samples of an excitation, which are in memory at once
SHORTEST = 4  # minimum number of samples of a frame, a burst or a pulse


def check_duration(name: str, seconds: float, rate_hz: int) -> None:
    """Raise a ConfigError that begins with `name` if a duration has fewer than `SHORTEST` samples at the rate."""
    if round(seconds * rate_hz) < SHORTEST:
        raise ConfigError(
            f"{name} must be at least {SHORTEST / rate_hz:g} s, {SHORTEST} samples at {rate_hz} Hz, got {seconds:g} s"
        )


@attrs.frozen(kw_only=True)
class Excitation:
    """Excitation signal for the measurement of a frequency response: frames of noise or chirps within a band.

    With the kind `burst_random`, each frame has a new burst of noise, followed by silence. With `pseudo_random`, one
    frame of noise is repeated. With `chirp`, one sweep from `low_hz` to `high_hz` is repeated. The signal has the level
    `rms`; for a burst the silence does not count.
    """

    kind: str = attrs.field(default=BURST, validator=attrs.validators.in_(KINDS))  # kind of signal, one of `KINDS`
    frames: int = attrs.field(default=20, validator=attrs.validators.ge(3))
    """Number of measured frames; before them, a repeated frame is played once as a run-in."""
    frame_s: float = attrs.field(default=8.0, validator=attrs.validators.gt(0.0))  # length of a frame [s]
    burst: float = attrs.field(default=0.5, validator=[attrs.validators.gt(0.0), attrs.validators.le(1.0)])
    """Fraction of a frame that a burst of noise fills; the rest is silence. Other kinds ignore it."""
    low_hz: float = attrs.field(default=4.0, validator=attrs.validators.gt(0.0))  # lower edge of the band
    high_hz: float = attrs.field(default=60.0, validator=attrs.validators.gt(0.0))  # upper edge of the band
    rms: float = attrs.field(default=0.2, validator=attrs.validators.gt(0.0))  # rms of the drive while it is on [A]
    seed: int = attrs.field(default=1, validator=attrs.validators.ge(0))  # seed of the random numbers of the noise

    def samples(self, rate_hz: int) -> Real:
        """Return the samples of all frames one after the other [A], shape (n,).

        With `pseudo_random` and `chirp` there is one additional frame at the beginning, as a run-in.

        Args:
            rate_hz: number of samples per second.

        Raises:
            ConfigError: the upper edge of the band is not below half of the rate, or not above the lower edge. Or a
                frame, or the burst in it, is too short for the rate and the band.
            BudgetError: there would be more than `MOST_SAMPLES` samples.
        """
        import numpy as np  # noqa: PLC0415  # the help of commands needs the settings alone
        import scipy  # noqa: PLC0415  # as above

        check_duration("frame_s", self.frame_s, rate_hz)
        length, random = round(self.frame_s * rate_hz), np.random.default_rng(self.seed)
        budget.allow(f"samples of {self.frames} frames at {rate_hz} Hz", (self.frames + 1) * length, MOST_SAMPLES)
        if not self.low_hz < self.high_hz < 0.5 * rate_hz:
            raise ConfigError(
                f"high_hz must be < {0.5 * rate_hz:g} Hz, half of the sample rate, got {self.high_hz:g} Hz"
                if self.low_hz < self.high_hz
                else f"low_hz must be < high_hz = {self.high_hz:g} Hz, got {self.low_hz:g} Hz"
            )
        if self.kind == BURST:
            check_duration("burst * frame_s", self.burst * self.frame_s, rate_hz)
            on = round(self.burst * length)
            sections = scipy.signal.butter(4, (self.low_hz, self.high_hz), "bandpass", fs=rate_hz, output="sos")
            fade = scipy.signal.windows.tukey(on, 0.1)
            frames = np.zeros((self.frames, length))
            noise = random.standard_normal((self.frames, 2 * on))
            frames[:, :on] = fade * scipy.signal.sosfilt(sections, noise)[:, on:]
            frames *= self.rms / np.sqrt(np.mean(frames[:, :on] ** 2))
            return frames.ravel()
        if self.kind == PSEUDO:
            lines = np.fft.rfftfreq(length, 1.0 / rate_hz)
            inside = (lines >= self.low_hz) & (lines <= self.high_hz)
            if not inside.any():
                raise ConfigError(
                    f"frame_s must be longer: with {self.frame_s:g} s the frequency lines are {lines[1]:g} Hz apart, "
                    f"and none is between low_hz = {self.low_hz:g} and high_hz = {self.high_hz:g}"
                )
            frame = np.fft.irfft(inside * np.exp(2j * np.pi * random.random(len(lines))), length)
        else:
            t = np.arange(length) / rate_hz
            frame = scipy.signal.chirp(t, self.low_hz, self.frame_s, self.high_hz)
            frame *= scipy.signal.windows.tukey(length, 0.05)
        return np.tile(frame * (self.rms / frame.std()), self.frames + 1)
