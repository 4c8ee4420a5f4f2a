# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a least-squares problem determines: Fisher information, its singular values, and combinations of parameters.

Parameters are logarithms, so a direction in their space is a product of powers, and 1/s, s a singular value of the
whitened Jacobian, is the relative standard uncertainty of that product. Nuisance parameters (gain errors of sensors,
say) are eliminated first: what they can imitate is no information.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import attrs
import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]

DETERMINED = 0.2
"""Relative standard uncertainty up to which a parameter, or a combination, counts as determined."""
LEAST_SHARE = 0.05
"""Powers below this share of the largest are left out of a combination's name."""
SMALLEST = 1e-9
"""Singular values below this share of the largest are rounding."""
UNTOUCHED = 1e-3
"""A parameter with less than this power in a combination that is not known at all does not take part in it."""


@attrs.frozen(eq=False)
class Combination:
    """A product of powers of parameters.

    Attributes:
        powers: by parameter, shape (n,); the largest is 1.
        u_relative: its relative standard uncertainty; infinite if the data say nothing.
        text: for people.
    """

    powers: Real
    u_relative: float
    text: str

    @property
    def determined(self) -> bool:
        """Whether the data determine it."""
        return self.u_relative <= DETERMINED


@attrs.frozen(eq=False)
class Information:
    """What the data say about logarithmic parameters.

    Attributes:
        names: of the parameters, n of them.
        combinations: independent ones, best determined first.
        u_relative: relative standard uncertainty of each parameter, infinite if it takes part in what is not known.
    """

    names: tuple[str, ...]
    combinations: tuple[Combination, ...]
    u_relative: Real

    def determined(self, name: str) -> bool:
        """Return whether the data determine a parameter by itself."""
        return bool(self.u_relative[self.names.index(name)] <= DETERMINED)

    def unknown(self) -> list[Combination]:
        """Return the combinations that the data do not determine."""
        return [combination for combination in self.combinations if not combination.determined]


def information(names: Sequence[str], jacobian: Real, nuisances: Real | None = None) -> Information:
    """Return what a whitened Jacobian says.

    Args:
        names: of the parameters.
        jacobian: d residual / d ln parameter, residuals in units of their standard uncertainty, shape (m, n).
        nuisances: the same for nuisance parameters, shape (m, k), rows of their prior knowledge included.
    """
    matrix = np.asarray(jacobian, float)
    if nuisances is not None and nuisances.shape[1]:
        basis, _ = np.linalg.qr(nuisances)
        matrix = matrix - basis @ (basis.T @ matrix)
    _, values, directions = np.linalg.svd(matrix, full_matrices=True)
    padded = np.zeros(len(names))
    padded[: len(values)] = values
    padded[padded < SMALLEST * padded.max(initial=0.0)] = 0.0
    with np.errstate(divide="ignore"):
        spread = 1.0 / padded
    combinations = tuple(
        _combination(names, direction, float(u)) for direction, u in zip(directions, spread, strict=True)
    )
    takes_part = np.isfinite(spread)[:, None] | (np.abs(directions) > UNTOUCHED)
    with np.errstate(invalid="ignore"):
        terms = np.where(takes_part, directions**2 * (spread**2)[:, None], 0.0)
    return Information(tuple(names), combinations, np.sqrt(terms.sum(axis=0)))


def _combination(names: Sequence[str], direction: Real, u: float) -> Combination:
    largest = int(np.argmax(np.abs(direction)))
    powers = direction / direction[largest]
    size = float(np.linalg.norm(powers))
    parts = [
        name if math.isclose(power, 1.0, abs_tol=5e-3) else f"{name}^{power:.2g}"
        for name, power in sorted(zip(names, powers, strict=True), key=lambda item: -abs(item[1]))
        if abs(power) >= LEAST_SHARE
    ]
    return Combination(powers, u * size, " · ".join(parts))
