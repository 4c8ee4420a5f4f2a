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
"""Periodic orbits as fixed points of a map z → f(z, p): Newton's method, multipliers, and continuation of branches.

The map f gives the state of the motion one return after the state z. A return is one cycle of the drive, or all cycles
after which the orbit repeats. The state is given by dimensionless coordinates z, shape (n,), and p is one dimensionless
parameter. f returns NaN if the state does not determine the motion, because the sphere is in contact with a wall.

A branch is a curve of orbits over p. Pseudo-arclength continuation (Keller 1977) searches for the next orbit in the
plane perpendicular to the tangent of the branch, and so follows the branch around a fold. The multipliers (eigenvalues
of ∂f/∂z) distinguish stable from unstable orbits, and the kinds of change along a branch:

    fold       the branch turns back in p                flip    a multiplier passes −1: orbits of twice the period
    symmetry   a multiplier passes 1 without a turn:     torus   a complex pair of multipliers passes the unit circle:
               the two half cycles become different              a second frequency appears
    grazing    multipliers jump over 1 or −1: an impact appears or disappears; close to it they grow without bound

A branch of period-doubled or asymmetric orbits also turns back where these orbits begin to exist. The argument `born`
of `followed` distinguishes such a turn from a fold.

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

# step of the differences: their truncation error is proportional to its square, the error by rounding and by the
# tolerance of the contacts to its reciprocal
STEP = 1e-6
TOLERANCE = 1e-10  # largest component of f(z, p) − z with which z counts as a fixed point
ROUNDS = 14  # maximum number of Newton steps
_SHORTEST = 2.0**-6  # smallest fraction to which a Newton step that increases the residual is shortened
ROUNDED = 1e-8  # tolerance if every step increases the residual, as with many impacts, where rounding errors limit it
_GIVEN_UP = 1e-5  # smallest step along a branch; if it fails too, the branch counts as lost
_GROWTH = 1.4  # factor of the step along a branch after a success
_TURN = 0.97  # cosine of the angle between successive tangents, below which a step was too long
_LOCATED = 1e-9  # accuracy with which a bifurcation is located, as a fraction of a step along the branch
NEUTRAL = 1e-4  # imaginary part above which a multiplier counts as one of a complex pair
# largest distance of the multiplier at a located bifurcation from 1, −1 or the unit circle; a larger one is a jump
PASSING = 1e-3
LASTING, FOLD, SYMMETRY, FLIP, TORUS, GRAZING = "stable", "fold", "symmetry", "flip", "torus", "grazing"
PASSED = {SYMMETRY: 1.0, FLIP: -1.0}


@attrs.frozen(eq=False)
class Orbit:
    """Periodic orbit: a fixed point z = f(z, p) of the map at one value p of its parameter, with its stability."""

    z: Real  # dimensionless coordinates of the fixed point, shape (n,)
    p: float  # dimensionless parameter of the map
    residual: float  # largest component of f(z, p) − z
    multipliers: NDArray[np.complex128]  # eigenvalues of df/dz, the largest modulus first, shape (n,)
    tangent: Real  # unit vector in the space (z, p) along the branch of the orbit, shape (n + 1,)
    note: object = None  # result of `noted` for this orbit if it belongs to a followed branch

    @property
    def stable(self) -> bool:
        """Return whether a small disturbance of the orbit decays: all multipliers are inside the unit circle."""
        return bool(abs(self.multipliers[0]) < 1.0)

    @property
    def kind(self) -> str:
        """Stability of the orbit as a word: `stable`, `torus`, `fold` or `flip`.

        An orbit that is not stable is named by its largest multiplier. The word is `torus` if this multiplier is one of
        a complex pair, otherwise `fold` if it is positive, else `flip`.
        """
        largest = self.multipliers[0]
        if self.stable:
            return LASTING
        return TORUS if abs(largest.imag) > NEUTRAL else FOLD if largest.real > 0.0 else FLIP

    def towards(self, direction: Real) -> Orbit:
        """Return the orbit with its tangent pointing along `direction`.

        Only the sign of the tangent changes, because the sign of a computed tangent is arbitrary.

        Args:
            direction: vector in the space (z, p), shape (n + 1,).
        """
        return self if float(self.tangent @ direction) >= 0.0 else attrs.evolve(self, tangent=-self.tangent)


@attrs.frozen(eq=False)
class BranchChange:
    """Bifurcation on a branch of orbits: where stability changes or the branch turns back in the parameter."""

    kind: str  # fold, symmetry, flip, torus or grazing
    orbit: Orbit  # orbit at which the change takes place
    note: object = None  # result of `noted` for that orbit


@attrs.frozen(eq=False)
class Arc:
    """Part of a branch of orbits that `followed` has found in one direction from its start orbit."""

    orbits: tuple[Orbit, ...]  # orbits in order along the branch, without the start orbit
    changes: tuple[BranchChange, ...]  # changes of stability or direction, in order along the branch
    end: str
    """Reason why the branch is not followed further: `edge`, `lost`, `closed` or `length`.

    `edge`: the parameter has reached an end of its range. `lost`: no next orbit is found even with the smallest step,
    as where an impact appears or disappears, or where the sphere is in contact at the section. `closed`: the branch has
    returned to its start orbit. `length`: the maximum number of orbits is reached.
    """


def jacobian(f: Map, z: Real, p: float) -> Real:
    """Return the matrix of derivatives ∂f_i/∂z_j of the map at (z, p) by central differences, shape (n, n)."""
    columns = []
    for i in range(len(z)):
        aside = np.zeros(len(z))
        aside[i] = STEP
        columns.append((f(z + aside, p) - f(z - aside, p)) / (2.0 * STEP))
    return np.stack(columns, axis=1)


def orbit(f: Map, z: Real, p: float) -> Orbit | None:
    """Find the periodic orbit (fixed point of the map f) near z at the parameter p by Newton's method.

    Returns None if the method does not converge, or f is NaN near the orbit.
    """
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
    """Follow the branch of periodic orbits through `start` in one direction, around folds, and locate its changes.

    Args:
        f: the map z → f(z, p) whose fixed points are the orbits.
        start: an orbit on the branch.
        way: initial direction: 1.0 towards larger p, −1.0 towards smaller p.
        limits: smallest and largest p; if the branch reaches one of them, its last orbit is searched for exactly there.
        longest: largest step along the branch in the space (z, p).
        points: maximum number of orbits, without `start`.
        noted: function that returns the `note` of an orbit. It is called for each orbit and for the orbit of each
            change, before `moved`.
        born: function that classifies a turn of the branch in p, given an orbit of the branch and the orbit at the
            turn. It returns `FLIP` if period-doubled orbits begin at the turn, `SYMMETRY` if asymmetric orbits begin
            there, else `FOLD`.
        moved: function that may change the coordinates of `f`, if its section is too close to an impact of the newest
            orbit. It receives the points (z, p) of the start and of the two newest orbits. It returns their z in the
            new coordinates, or None if nothing changes.
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
    """Find the orbit near the guess (z, p) by Newton's method; return None if the method does not converge.

    Without a `tangent`, p is fixed. With a `tangent`, p changes too: the orbit is searched for in the plane through the
    guess that is perpendicular to the tangent.
    """
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
    """Return the matrix of Newton's method for the unknowns y = (z, p), shape (n + 1, n + 1).

    Its first n rows are the derivatives of f(z, p) − z. Its last row is the tangent; without a tangent, the matrix
    keeps p fixed. `numpy.linalg.LinAlgError` is raised if a derivative is not finite.
    """
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
    """Return the `Orbit` at a known fixed point y = (z, p), with its multipliers and tangent.

    The sign of the tangent is arbitrary. The result is None if the map is NaN at a neighbouring point, so that the
    derivatives do not exist.
    """
    z, p = y[:-1], float(y[-1])
    try:
        rows = _extended(f, y, np.zeros(len(y)))[:-1]
    except np.linalg.LinAlgError:
        return None
    multipliers = np.linalg.eigvals(rows[:, :-1] + np.eye(len(z))).astype(np.complex128)
    order = np.lexsort((-multipliers.imag, -np.round(np.abs(multipliers), 12)))
    return Orbit(z, p, float(np.abs(f(z, p) - z).max()), multipliers[order], np.linalg.svd(rows)[2][-1])


def _changes(f: Map, here: Orbit, new: Orbit, born: Callable[[Orbit, Orbit], str]) -> Iterator[BranchChange]:
    """Yield the bifurcations between two successive orbits of a branch.

    Each bifurcation is located where its test function is zero. Bifurcations that cannot be located are left out.
    `born` classifies a turn of the branch in p, see `followed`. Where a multiplier jumps over 1 or −1, the kind is
    `GRAZING`. The order is by kind, not along the branch.
    """
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
    """Return Π (multiplier − value) over all multipliers of an orbit, the test of `SYMMETRY` (1) and `FLIP` (−1).

    It is real, and its sign differs between two orbits if one real multiplier has passed `value` between them.
    """
    return float(np.prod(one.multipliers - value).real)


def _pairs(one: Orbit) -> float:
    """Return Π (μ_i μ_j − 1) over all pairs of multipliers of an orbit, the test function of a torus bifurcation.

    It is zero when a complex pair of multipliers is on the unit circle, but also when two real ones have the product 1.
    """
    products = np.outer(one.multipliers, one.multipliers)[np.triu_indices(len(one.multipliers), 1)]
    return float(np.prod(products - 1.0).real)


def _zero(f: Map, here: Orbit, new: Orbit, test: Callable[[Orbit, Real], float]) -> Orbit | None:
    """Return the orbit on the branch between two successive orbits at which a test function is zero.

    `test` receives an orbit, and its tangent in the direction from `here` to `new`. Returns None if Newton's method
    fails between them, or the test function does not change its sign after all.
    """
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
