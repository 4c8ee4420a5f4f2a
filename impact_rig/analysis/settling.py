# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Has the response settled? Judged from successive windows of the complex transmissibility, not from a fixed wait.

A dying transient adds a term c·q^w to the value of window w, q complex (decay and beat of the free vibration against
the drive). Its sum beyond the last window follows from the differences of the windows (Aitken), which gives the bias
of a mean *including* the part that differences of neighbours cannot show.
"""

from __future__ import annotations

import math

import numpy as np

from impact_rig.analysis.calibration import Complex
from impact_rig.analysis.spread import variance_of_mean

SLOWEST_RATIO = 0.97
"""|q| is bounded here: slower transients than 33 window pairs per time constant are beyond what a fit can tell."""
TREND_LIMIT = 3.0
"""Difference of the halves, in standard deviations, that still counts as no trend."""
POWER_LIMIT = 4.0
"""Ratio of the fluctuation power of the halves that still counts as stationary."""


def transient_bias(windows: Complex, measured: int) -> complex:
    """Return the bias that a dying transient leaves in the mean of the newest windows; noise-sized where there is none.

    The limit is extrapolated from the newest 8 windows and, where there are as many, from the newest 16: the longer
    record sees slow transients below the noise of the shorter one. The larger bias counts.

    Args:
        windows: the value in successive windows of equal length, oldest first, shape (n,).
        measured: number of newest windows whose mean is used, 8 <= measured <= n.

    Raises:
        ValueError: there are fewer windows.
    """
    if not 8 <= measured <= len(windows):
        raise ValueError(f"measured must be 8 to {len(windows)}, the number of windows, got {measured}")
    mean = complex(windows[-measured:].mean())
    spans = [span for span in (8, 16) if span <= len(windows)]
    return max((mean - _limit(windows[-span:].reshape(4, -1).mean(axis=1)) for span in spans), key=abs)


def more_windows(taken: int, reached: float, share: float) -> int:
    """Return for how many more windows a dying transient must be waited for, at the pace it has died so far.

    One that began as large as the response itself and took n windows to fall to a part ε of it takes
    n ln(s) / ln(ε) more to fall by another factor s. A transient below the noise cannot be followed, its pace can.

    Args:
        taken: windows from the change of the drive to the first of those that are measured, n.
        reached: part of the response that the transient has fallen to, ε.
        share: s, 0 < s < 1.
    """
    return math.ceil(taken * math.log(share) / math.log(reached)) if 0.0 < reached < 1.0 else 0


def _limit(quarters: Complex) -> complex:
    """Return where four successive values tend to: Aitken, with q from both pairs of differences."""
    steps = np.diff(quarters)
    power = float(np.sum(np.abs(steps[:-1]) ** 2))
    if power == 0.0:
        return complex(quarters[3])
    ratio = complex(np.sum(steps[1:] * np.conj(steps[:-1])) / power)
    if abs(ratio) > SLOWEST_RATIO:
        ratio *= SLOWEST_RATIO / abs(ratio)
    return complex(quarters[3] + steps[2] * ratio / (1.0 - ratio))


def is_stationary(windows: Complex) -> bool:
    """Return whether a fluctuating value has neither trend nor growing or dying fluctuation: settled, if not constant.

    The means of the halves may differ by `TREND_LIMIT` standard deviations (correlation between windows included) in
    either component; the fluctuation powers of the halves by a factor `POWER_LIMIT`.

    Args:
        windows: shape (n,), n >= 16.
    """
    half = len(windows) // 2
    first, second = windows[:half], windows[half : 2 * half]
    for a, b in ((first.real, second.real), (first.imag, second.imag)):
        scatter = variance_of_mean(a) + variance_of_mean(b)
        if (b.mean() - a.mean()) ** 2 > TREND_LIMIT**2 * scatter:
            return False
    powers = np.var(first), np.var(second)
    return bool(max(powers) <= POWER_LIMIT * min(powers))
