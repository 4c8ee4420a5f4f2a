# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Drop test → coefficient of restitution: a sphere dropped from H0 on the fixed barrier rebounds to H1.

e = √(H1/H0),   (u(e)/e)² = ¼ [(u(H1)/H1)² + (u(H0)/H0)²]

The operator notes the heights as a remark on the topic `notes`: `drop h0_m=0.2 h1_m=0.0245`.
"""

from __future__ import annotations

import math
import re

import attrs
import numpy as np

from impact_rig.analysis.calibration import Real
from impact_rig.analysis.words import Status

_NUMBER = r"[0-9.eE+-]{1,32}"
_PATTERN = re.compile(rf"\s*drop\s+h0_m\s*=\s*(?P<h0>{_NUMBER})\s+h1_m\s*=\s*(?P<h1>{_NUMBER})\s*")


@attrs.frozen
class Drop:
    """Heights of one drop [m]: where the sphere was let go, and how high it came back."""

    h0_m: float
    h1_m: float

    def text(self) -> str:
        """Return the remark; `parse_drop` reads it back exactly."""
        return f"drop h0_m={self.h0_m!r} h1_m={self.h1_m!r}"


def parse_drop(remark: str) -> Drop | None:
    """Return the drop in a remark, or None if it is any other remark."""
    match = _PATTERN.fullmatch(remark)
    if match is None:
        return None
    try:
        return Drop(float(match["h0"]), float(match["h1"]))
    except ValueError:
        return None


@attrs.frozen(kw_only=True)
class DropTest:
    """Coefficient of restitution with its standard uncertainty; NaN where the heights give none."""

    status: Status
    restitution: float = math.nan
    u_restitution: float = math.nan
    drops: int = 0


def restitution_of_drops(h0_m: Real, h1_m: Real, u_h0_m: float, u_h1_m: float) -> DropTest:
    """Return the mean e of repeated drops; the uncertainty of the heights is independent from drop to drop.

    With several drops the scatter of e counts if it is larger than the heights explain: the sphere and barrier vary.

    Args:
        h0_m: heights of the drops, shape (n,).
        h1_m: heights of the rebounds, shape (n,).
        u_h0_m: standard uncertainty of each h0.
        u_h1_m: standard uncertainty of each h1.

    Returns:
        `not_finite` for values that are not finite, `no_fit` for heights that are not positive, uncertainties that are
        negative, or a rebound higher than the drop by more than three standard uncertainties.
    """
    if h0_m.shape != h1_m.shape or h0_m.ndim != 1 or not len(h0_m):
        raise ValueError(f"h0_m and h1_m must be one-dimensional and of equal length, got {h0_m.shape}, {h1_m.shape}")
    if not (np.all(np.isfinite(h0_m)) and np.all(np.isfinite(h1_m)) and math.isfinite(u_h0_m + u_h1_m)):
        return DropTest(status=Status.NOT_FINITE)
    higher = h1_m - h0_m > 3.0 * math.hypot(u_h0_m, u_h1_m)
    if min(u_h0_m, u_h1_m) < 0.0 or np.any(h0_m <= 0.0) or np.any(h1_m <= 0.0) or np.any(higher):
        return DropTest(status=Status.NO_FIT)
    each = np.sqrt(h1_m / h0_m)
    n = len(each)
    explained = float(np.sum(each**2 * ((u_h1_m / h1_m) ** 2 + (u_h0_m / h0_m) ** 2) / 4.0)) / n**2
    scatter = float(np.var(each, ddof=1)) / n if n > 1 else 0.0
    return DropTest(
        status=Status.OK,
        restitution=float(each.mean()),
        u_restitution=math.sqrt(max(explained, scatter)),
        drops=n,
    )
