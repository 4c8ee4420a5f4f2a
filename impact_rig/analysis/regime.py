"""What the response does from cycle to cycle: periodic, modulated or chaotic.

Judged on ε_k, the relative deviation of the fundamental of x_1 fitted cycle by cycle. A subharmonic orbit (2.5 impacts
per cycle: five impacts in two cycles) repeats after p cycles: the deviation from the mean of each class k mod p must
vanish within noise, or within a tolerance that does not matter. What is left is told apart by its spectrum: a few lines
(modulated) or a continuum (chaotic); that boundary is a convention, as for any finite record.
"""

from __future__ import annotations

import attrs
import numpy as np

from impact_rig.analysis.calibration import Complex
from impact_rig.analysis.spread import by_class_removed
from impact_rig.analysis.words import Regime

LONGEST_PERIOD = 8
NOISE_FACTOR = 2.0
"""Variance ratio up to which a class scatter counts as noise: 48 cycles exceed it by chance once in a million."""
LINES = 3
"""A response is modulated when this many spectral lines, each as wide as the window's main lobe, hold LINE_SHARE."""
LINE_SHARE = 0.8


@attrs.frozen
class Response:
    """Regime, period in drive cycles (NaN if none) and relative cycle-to-cycle spread (rms, noise included)."""

    regime: Regime
    period: float
    spread: float


def classify(deviation: Complex, noise_variance: float, tolerance: float) -> Response:
    """Return what a response does.

    Args:
        deviation: ε_k per cycle, shape (n,).
        noise_variance: E|ε|² that noise alone explains.
        tolerance: rms deviation that counts as none.

    Returns:
        `unknown` for fewer than 2 cycles of every class, i.e. n < 4.
    """
    n = len(deviation)
    if n < 4 or not np.all(np.isfinite(deviation)):
        return Response(Regime.UNKNOWN, float("nan"), float("nan"))
    spread = float(np.sqrt(np.mean(np.abs(deviation - deviation.mean()) ** 2)))
    limit = max(NOISE_FACTOR * noise_variance, tolerance**2)
    for period in range(1, min(LONGEST_PERIOD, n // 4) + 1):
        left = by_class_removed(deviation, period)
        if float(np.sum(np.abs(left) ** 2)) / (n - period) <= limit:
            return Response(Regime.PERIODIC, float(period), spread)
    regime = Regime.MODULATED if _line_share(deviation) >= LINE_SHARE else Regime.CHAOTIC
    return Response(regime, float("nan"), spread)


def _line_share(deviation: Complex) -> float:
    """Return the share of the fluctuation power in its strongest `LINES` lines; Hann window, main lobe 5 bins."""
    n = len(deviation)
    power = np.abs(np.fft.fft((deviation - deviation.mean()) * np.hanning(n + 1)[:n])) ** 2
    total = float(power.sum())
    share = 0.0
    for _ in range(LINES):
        lobe = (int(np.argmax(power)) + np.arange(-2, 3)) % n
        share += float(power[lobe].sum())
        power[lobe] = 0.0
    return share / total
