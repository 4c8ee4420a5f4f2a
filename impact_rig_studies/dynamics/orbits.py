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
"""Periodic orbits as fixed points of a map z → f(z, p): Newton's method, multipliers, branches around folds.

The map is a function of dimensionless coordinates z, shape (n,), and of one dimensionless parameter p. It must be
smooth only near the orbit: derivatives are central differences. For an orbit that repeats after several returns, the
map is all of them together. It returns NaN if the motion is undetermined (within a contact).

A branch is followed by pseudo-arclength (Keller 1977): the next point is searched for in the plane across the tangent,
so that folds are no obstacle. The multipliers distinguish stable from unstable orbits, and the kind of change between
them:

    fold       the branch turns back in p             flip    a multiplier passes −1: twice the period
    symmetry   a multiplier passes 1, no turn: the    torus   a pair passes the unit circle: a second frequency
               two half cycles become different
    grazing    multipliers jump over 1 or −1: an impact comes or goes; nearby they grow beyond all bounds

A branch of doubled or asymmetric orbits also turns back at its birth. It continues there as the same orbits begun half
a period later, or as their mirror images. `born` distinguishes such a turn from a fold.

H. B. Keller (1977), "Numerical solution of bifurcation and nonlinear eigenvalue problems", in P. H. Rabinowitz (ed.),
Applications of Bifurcation Theory, Academic Press, 359–384.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Real

Map = Callable[[Real, float], Real]

# step of the differences: truncation falls with its square, rounding and the contacts' tolerance with its reciprocal
STEP = 1e-6
TOLERANCE = 1e-10  # largest component of f(z, p) − z of an orbit
ROUNDS = 14
_SHORTEST = 2.0**-6  # smallest fraction of a Newton step that increases the residual
ROUNDED = 1e-8  # tolerance if rounding and the contacts' tolerance leave no less: a motion with many impacts
_GIVEN_UP = 1e-5  # smallest step along a branch
_GROWTH = 1.4  # growth of the step along a branch after a success
_TURN = 0.97  # cosine between successive tangents, below which a step was too long
_LOCATED = 1e-9  # fraction of a step to which a bifurcation is located
NEUTRAL = 1e-4  # distance from 1 within which a multiplier counts as 1, only for the choice of a word
# largest distance of a bifurcation's multiplier from the point it passes; otherwise it has jumped over it
PASSING = 1e-3
LASTING, FOLD, SYMMETRY, FLIP, TORUS, GRAZING = "stable", "fold", "symmetry", "flip", "torus", "grazing"
PASSED = {SYMMETRY: 1.0, FLIP: -1.0}


@attrs.frozen(eq=False)
class Orbit:
    """Fixed point of the map."""

    z: Real  # coordinates, shape (n,)
    p: float  # parameter
    residual: float  # largest component of f(z, p) − z
    multipliers: NDArray[np.complex128]  # eigenvalues of df/dz, the largest first, shape (n,)
    tangent: Real  # unit vector (z, p) along the branch, shape (n + 1,)
    note: object = None  # additional result along a branch

    @property
    def stable(self) -> bool:
        """Return whether small errors decay."""
        return bool(abs(self.multipliers[0]) < 1.0)

    @property
    def kind(self) -> str:
        """Kind of stability: `stable`, or fold, flip or torus, by which the orbit loses its stability."""
        largest = self.multipliers[0]
        if self.stable:
            return LASTING
        return TORUS if abs(largest.imag) > NEUTRAL else FOLD if largest.real > 0.0 else FLIP

    def towards(self, direction: Real) -> Orbit:
        """Return the orbit with that of its two tangents that points along a direction (z, p), shape (n + 1,)."""
        return self if float(self.tangent @ direction) >= 0.0 else attrs.evolve(self, tangent=-self.tangent)


@attrs.frozen(eq=False)
class BranchChange:
    """Change along a branch."""

    kind: str  # fold, symmetry, flip, torus or grazing
    orbit: Orbit  # orbit at the change
    note: object = None  # note of that orbit


@attrs.frozen(eq=False)
class Arc:
    """Branch in one direction from an orbit."""

    orbits: tuple[Orbit, ...]  # in order, without the first one
    changes: tuple[BranchChange, ...]  # changes of stability or direction, in order
    end: str
    """Reason for its end: `edge` of the range, `lost` (no step is short enough.

    An impact comes or goes, or the motion is undetermined at the section), `closed`, or `length`.
    """


def jacobian(f: Map, z: Real, p: float) -> Real:
    """Return df/dz by central differences, shape (n, n)."""
    columns = []
    for i in range(len(z)):
        aside = np.zeros(len(z))
        aside[i] = STEP
        columns.append((f(z + aside, p) - f(z - aside, p)) / (2.0 * STEP))
    return np.stack(columns, axis=1)


def orbit(f: Map, z: Real, p: float) -> Orbit | None:
    """Return the fixed point near z, or None if Newton's method finds none."""
    return _corrected(f, z, p, None)


def followed(
    f: Map,
    start: Orbit,
    way: float,
    limits: tuple[float, float],
    *,
    longest: float = 0.1,
    points: int = 400,
    noted: Callable[[Orbit], object] = lambda _: None,
    born: Callable[[Orbit, Orbit], str] = lambda _here, _turn: FOLD,
    moved: Callable[[Sequence[tuple[Real, float]]], list[Real] | None] = lambda _: None,
) -> Arc:
    """Follow the branch of an orbit in one direction.

    Args:
        f: the map.
        start: an orbit on the branch.
        way: −1.0 or 1.0: p falls or rises at first.
        limits: smallest and largest p.
        longest: largest step along the arc.
        points: maximum number of points.
        born: classifies a turn, given an orbit of the branch and that at the turn: `FLIP` or `SYMMETRY` at the birth of
            its orbits, else `FOLD`.
        noted: returns the `note` of every orbit while `f` uses its coordinates.
        moved: given the first point (z, p) and the newest two, returns the z of all in other coordinates that `f` uses
            from now on, or None.
    """
    orbits: list[Orbit] = []
    changes: list[BranchChange] = []
    here, length, first = start.towards(np.append(np.zeros(len(start.z)), way)), longest / 4.0, start.z
    while len(orbits) < points:
        guess = np.append(here.z, here.p) + length * here.tangent
        new = _corrected(f, guess[:-1], float(guess[-1]), here.tangent)
        new = new and new.towards(here.tangent)
        if new is None or float(new.tangent @ here.tangent) < _TURN:
            length *= 0.5
            if length < _GIVEN_UP:
                return Arc(tuple(orbits), tuple(changes), "lost")
            continue
        if not limits[0] <= new.p <= limits[1]:
            edge = limits[0] if new.p < limits[0] else limits[1]
            share = (edge - here.p) / (new.p - here.p)
            last = orbit(f, here.z + share * (new.z - here.z), edge)
            if last is not None:
                last = last.towards(here.tangent)
                changes += [attrs.evolve(one, note=noted(one.orbit)) for one in _changes(f, here, last, born)]
                orbits.append(attrs.evolve(last, note=noted(last)))
            return Arc(tuple(orbits), tuple(changes), "edge")
        changes += [attrs.evolve(one, note=noted(one.orbit)) for one in _changes(f, here, new, born)]
        orbits.append(attrs.evolve(new, note=noted(new)))
        if len(orbits) > 3 and np.abs(np.append(new.z - first, new.p - start.p)).max() < 0.5 * length:
            return Arc(tuple(orbits), tuple(changes), "closed")
        seen = moved([(first, start.p), (here.z, here.p), (new.z, new.p)])
        if seen is not None:  # in other coordinates from now on
            first, *secant = seen
            located = _orbit_at(f, np.append(secant[1], new.p))
            if located is None:
                return Arc(tuple(orbits), tuple(changes), "lost")
            new = located.towards(np.append(secant[1] - secant[0], new.p - here.p))
        here, length = new, min(longest, _GROWTH * length)
    return Arc(tuple(orbits), tuple(changes), "length")


def _corrected(f: Map, z: Real, p: float, tangent: Real | None) -> Orbit | None:
    """Return the orbit near a guess: in the plane across the tangent, or at the same p. None if there is none."""
    y = origin = np.append(z, p)
    residual = f(z, p) - z
    for _ in range(ROUNDS):
        size = float(np.abs(residual).max())
        if not math.isfinite(size):
            return None
        if size <= TOLERANCE:
            return _orbit_at(f, y)
        try:
            matrix = _extended(f, y, tangent)
            across = 0.0 if tangent is None else float(tangent @ (y - origin))
            change = np.linalg.solve(matrix, np.append(-residual, -across))
        except np.linalg.LinAlgError:
            return None
        share = 1.0
        while True:
            trial = y + share * change
            after = f(trial[:-1], float(trial[-1])) - trial[:-1]
            if float(np.abs(after).max()) < size:
                break
            share *= 0.5
            if share < _SHORTEST:
                return _orbit_at(f, y) if size < ROUNDED else None
        y, residual = trial, after
    return _orbit_at(f, y) if float(np.abs(residual).max()) <= TOLERANCE else None  # the last round may have found it


def _extended(f: Map, y: Real, tangent: Real | None) -> Real:
    """Return the matrix of the equations for (z, p); without a tangent p is fixed."""
    z, p = y[:-1], float(y[-1])
    n = len(z)
    matrix = np.zeros((n + 1, n + 1))
    matrix[:n, :n] = jacobian(f, z, p) - np.eye(n)
    if tangent is None:
        matrix[n, n] = 1.0
    else:
        matrix[:n, n] = (f(z, p + STEP) - f(z, p - STEP)) / (2.0 * STEP)
        matrix[n] = tangent
    if not np.isfinite(matrix).all():
        raise np.linalg.LinAlgError
    return matrix


def _orbit_at(f: Map, y: Real) -> Orbit | None:
    """Return the orbit at (z, p), or None if its neighbours are undetermined."""
    z, p = y[:-1], float(y[-1])
    try:
        rows = _extended(f, y, np.zeros(len(y)))[:-1]
    except np.linalg.LinAlgError:
        return None
    multipliers = np.linalg.eigvals(rows[:, :-1] + np.eye(len(z))).astype(np.complex128)
    order = np.lexsort((-multipliers.imag, -np.round(np.abs(multipliers), 12)))
    return Orbit(z, p, float(np.abs(f(z, p) - z).max()), multipliers[order], np.linalg.svd(rows)[2][-1])


def _changes(f: Map, here: Orbit, new: Orbit, born: Callable[[Orbit, Orbit], str]) -> Iterator[BranchChange]:
    """Yield the changes between two neighbours, where a test function passes zero."""
    tests: dict[str, Callable[[Orbit, Real], float]] = {}
    if here.tangent[-1] * new.tangent[-1] < 0.0:
        tests[FOLD] = lambda _, along: float(along[-1])
    elif _product(here, 1.0) * _product(new, 1.0) < 0.0:
        tests[SYMMETRY] = lambda one, _: _product(one, 1.0)
    if _product(here, -1.0) * _product(new, -1.0) < 0.0:
        tests[FLIP] = lambda one, _: _product(one, -1.0)
    if _pairs(here) * _pairs(new) < 0.0:
        tests[TORUS] = lambda one, _: _pairs(one)
    for kind, test in tests.items():
        found = _zero(f, here, new, test)
        if found is None:
            continue
        paired = found.multipliers[found.multipliers.imag > NEUTRAL]
        if kind == TORUS and not (np.abs(np.abs(paired) - 1.0) < PASSING).any():
            continue  # no pair of complex multipliers is on the unit circle
        jumps = kind in PASSED and float(np.abs(found.multipliers - PASSED[kind]).min()) > PASSING
        yield BranchChange(GRAZING if jumps else born(here, found) if kind == FOLD else kind, found)


def _product(one: Orbit, value: float) -> float:
    """Return Π (multiplier − value), which is real and changes sign when one real multiplier passes."""
    return float(np.prod(one.multipliers - value).real)


def _pairs(one: Orbit) -> float:
    """Return Π (product of two multipliers − 1), which is zero when a pair is on the unit circle."""
    products = np.outer(one.multipliers, one.multipliers)[np.triu_indices(len(one.multipliers), 1)]
    return float(np.prod(products - 1.0).real)


def _zero(f: Map, here: Orbit, new: Orbit, test: Callable[[Orbit, Real], float]) -> Orbit | None:
    """Return the orbit between two at which a test function is zero."""
    origin, whole = np.append(here.z, here.p), np.append(new.z - here.z, new.p - here.p)
    found = here

    def value(share: float) -> float:
        nonlocal found
        guess = origin + share * whole
        one = _corrected(f, guess[:-1], float(guess[-1]), here.tangent)
        if one is None:
            raise ArithmeticError
        found = one
        return test(found, found.towards(whole).tangent)

    try:
        scipy.optimize.brentq(value, 0.0, 1.0, xtol=_LOCATED)
    except (ArithmeticError, ValueError):  # no orbit there, or only an apparent change of sign
        return None
    return found
