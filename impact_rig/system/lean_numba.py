# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Numba without a BLAS, for processes that run nothing but this package.

Before its first function Numba loads SciPy's linear algebra, in case a function calls `np.dot`: 0.4 s and 15 MB of
every start. No kernel of this package may call it, since a BLAS adds in an order of its own on every CPU.
"""

from __future__ import annotations

from typing import NoReturn

from numba.np import linalg


def go_without_blas() -> None:
    """Keep Numba from looking for a BLAS; called before its first function is compiled or loaded."""
    linalg.ensure_blas = _refuse


def _refuse() -> NoReturn:
    raise ImportError("this process has no BLAS for compiled functions")
