# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Amplitude spectra for plotters: of the last seconds, through a flat-top window, so that heights are amplitudes.

The window has five cosine terms (`scipy.signal.windows.flattop`; d'Antona and Ferrero, Digital Signal Processing for
Measurement Systems, 2006): a line between two bins is 0.1 % too low at worst, for which it is ten bins wide.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WINDOW_S = 4.0
"""Length of the window: bins are 0.25 Hz apart, and lines closer than 2.5 Hz are not told apart."""
EVERY_S = 1.0
"""Rig time from one spectrum to the next."""
HIGHEST_HZ = 250.0
"""Highest frequency shown: the drive's 27th harmonic at 9.1 Hz; faster scans do not make the message longer."""


def amplitude_spectrum(samples: Array, rate_hz: float) -> tuple[Array, Array]:
    """Return frequencies [Hz] and amplitudes (peak, unit of the samples) up to `HIGHEST_HZ`, each of shape (bins,).

    Args:
        samples: of one channel, shape (n,); the mean is taken away first.
        rate_hz: samples per second.
    """
    window = _flat_top(len(samples))
    transformed = np.fft.rfft((samples - samples.mean()) * window)
    shown = min(len(transformed), int(HIGHEST_HZ * len(samples) / rate_hz) + 1)
    frequencies: Array = np.arange(shown) * np.float64(rate_hz / len(samples))
    amplitudes: Array = 2.0 * np.abs(transformed[:shown]) / window.sum()
    return frequencies, amplitudes


@functools.lru_cache(maxsize=2)
def _flat_top(length: int) -> Array:
    from scipy.signal import windows  # noqa: PLC0415  # 60 MB, which only those who plot pay

    window: Array = windows.flattop(length, sym=False)
    return window
