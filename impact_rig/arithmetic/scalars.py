# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Numbers and functions for code that is not compiled: the same bits, but compiled code is loaded by the first call."""

from __future__ import annotations

PI = 3.141592653589793
TWO_PI = 6.283185307179586


def exp(x: float) -> float:
    """Return e^x as `elementary.exp` does."""
    from impact_rig.arithmetic import elementary  # noqa: PLC0415  # compiled: see above

    return float(elementary.exp(x))


def log(x: float) -> float:
    """Return ln x as `elementary.log` does."""
    from impact_rig.arithmetic import elementary  # noqa: PLC0415  # compiled: see above

    return float(elementary.log(x))
