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
"""Tables of the outcomes of fast contacts, computed once for each contact law.

The outcome of a fast contact depends on so few numbers that it can be tabulated.

Let v0 be the approach speed, t_0 = (m_eff/K)^(1/(1+b)) v0^((1−b)/(1+b)), δ_0 = v0 t_0, Δ = δ/δ_0, θ = t/t_0 and Δ' =
dΔ/dθ, with F in units of m_eff δ_0/t_0². A contact of a law F ~ K δ^b without a scale of its own then obeys

    Δ'' = −F(Δ, Δ') + η_0 + η_1 θ + η_2 θ² − α Δ − γ Δ',    Δ = 0, Δ' = 1 at θ = 0
    η_k = (k-th Taylor coefficient of a_r about the touch) t_0^(k+1) / v0,   α = t_0² σ k_1 / m_1,   γ = t_0 σ c_1 / m_1

with a_r the relative acceleration that presses sphere and wall together, and σ, k_1 and c_1 of the columns as in
`contact_step`. η_0 is a few hundredths and the rest, called perturbations here, are parts in a million.
`perturbed_contact` integrates that equation, and `look_up` computes from the table

    outcome = plain + η_1 ∂/∂η_1 plain   [+ (½ η_1² ∂²/∂η_1² + η_2 ∂/∂η_2 + α ∂/∂α + γ ∂/∂γ) plain]

with plain and its derivatives at η_1 = η_2 = α = γ = 0, each a Chebyshev series in η_0. The terms in brackets are added
to the first three quantities, the DECISIVE ones. Contacts beyond the table's range are integrated step by step. Those
inside agree with the integration within 1e-10.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import PI, sincos
from impact_rig.kernels import REALS, Reals, Record, Records, entry, kernel
from impact_rig.physics.collocation import LAST, MATRIX, STAGES
from impact_rig.physics.contact.law import FORCE, CompiledForce, raise_failure
from impact_rig.physics.contact_phase import conclude, find_peaks, take_step
from impact_rig.physics.contact_step import drop_dense_output, pair_at
from impact_rig.physics.state import CONTACT_STEP, NOTHING, PARAMETERS, SEPARATED, STATE, TURNED, V1, VB, X1, XB, record

SEPARATION, DURATION, LOST, PEAK, DEPTH, SUM, MOMENT = range(7)
"""Indices of the outcomes of a contact, which are in units made of m_eff, v0 and t_0: separation speed, duration,
energy lost, peak force, largest indentation, ∫ Δ dθ and ∫ (θ_end − θ) Δ dθ.
"""
OUTCOMES = 7
BY_ETA_1_SQUARED, BY_ETA_2, BY_STIFFNESS, BY_DAMPING = range(4)
"""Indices of the derivatives that only the first DECISIVE outcomes have in a table: ½ ∂²/∂η_1², ∂/∂η_2, ∂/∂α, ∂/∂γ."""
DECISIVE = 3  # number of outcomes that have these derivatives
SERIES_COUNT = 2 * OUTCOMES + 4 * DECISIVE
"""Number of columns of the series: all outcomes, their derivatives by η_1, and the further derivatives of the DECISIVE
outcomes.
"""
COEFFICIENTS = 20
_COEFFICIENTS_1, _COEFFICIENTS_2 = 14, 7  # of the derivatives, whose factors are below MOST_1 and MOST_2

WIDEST = 0.1  # of |η_0|
MOST_1, MOST_2, MOST_3 = 3e-4, 2e-7, 1e-10
"""Limits within which a table is used: MOST_1 for |η_1|, MOST_2 for |η_2|, α and γ, and MOST_3 for |η_3|, whose effect
is not tabulated. Beyond them an outcome could be wrong by 1e-10, and the contact is integrated instead.
"""
_NARROWER = 0.8
_NARROWINGS = 24
_MARGIN = 1.1  # of the range in which the sphere leaves by itself, for the derivatives at its ends
_WEAKEST = 0.3  # of the energy with which the sphere leaves: below it the outcome turns steep
_TAIL = 1e-11  # of the largest coefficient
RTOL = 1e-12
"""Relative tolerance with which the contacts are integrated that the table is computed from."""
_PERTURBATION = 1e-4
_MOST_STEPS = 400

TABLE = np.dtype(
    [
        ("low", "f8"),  # lower end of the range of η_0 [-]
        ("high", "f8"),  # its upper end, 0 where nothing is tabulated [-]
        ("series", "f8", (COEFFICIENTS, SERIES_COUNT)),  # Chebyshev coefficients of each column, by degree [-]
        ("value", "f8", (SERIES_COUNT,)),  # of each column at the η_0 looked up last [-]
        ("outcome", "f8", (OUTCOMES,)),  # outcome looked up last, in the contact's own units [-]
    ],
    align=True,
)


@entry(PARAMETERS, FORCE, float, REALS, STATE, CONTACT_STEP, REALS, returns=bool)
def perturbed_contact(
    parameters: Records,
    law: CompiledForce,
    eta_0: float,
    perturbations: Reals,
    states: Records,
    steps: Records,
    out: Reals,
) -> bool:
    """Integrate one contact in dimensionless units; return whether the sphere left the wall at zero indentation.

    `eta_0` is η_0, and `perturbations` are (η_1, η_2, α, γ). The docstring of this module defines these symbols and the
    units. The outcome of the contact is stored in `out`, shape (OUTCOMES,), and is valid only if the result is true.
    `parameters`, `states` and `steps` are one record each, and are modified.
    """
    p, s, step = parameters[0], states[0], steps[0]
    eta_1, eta_2, gamma = perturbations[0], perturbations[1], perturbations[3]
    p.slowing_by_depth, p.slowing_by_speed = perturbations[2], gamma
    s.w, s.speed, s.deepest_w, s.per_v0, s.peak_force, s.t = 0.0, 1.0, 0.0, 1.0, 0.0, 0.0
    s.next_h = 0.1
    drop_dense_output(step)
    out[:] = 0.0
    damped, largest_lossy = 0.0, 0.0
    step.acceleration[:] = 0.0
    step.time_left = step.valid_for = math.inf
    step.terms = 3
    for _ in range(_MOST_STEPS):
        t = s.t
        step.acceleration[0] = eta_0 + t * (eta_1 + t * eta_2)
        step.acceleration[1], step.acceleration[2] = eta_1 + 2.0 * t * eta_2, eta_2
        ended = take_step(p, law, s, step)
        if ended not in (NOTHING, SEPARATED, TURNED):
            return False
        since = step.since[LAST]
        out[MOMENT] += since * out[SUM]
        for i in range(STAGES):
            area = s.h * MATRIX[LAST, i] * step.w[i] * step.w[i] * step.w[i]
            out[SUM] += area
            out[MOMENT] += (since - step.since[i]) * area
            largest_lossy = max(largest_lossy, abs(step.lossy[i]))
            damped += s.h * MATRIX[LAST, i] * step.w[i] * step.speed[i] * step.speed[i]
        find_peaks(p, law, s, step)
        conclude(p, s, step, ended, 0.0)
        step.dense_since = 0.0  # a prediction from the start of the last step, on which the bits of the tables depend
        if ended == SEPARATED:
            out[SEPARATION], out[DURATION], out[DEPTH] = -s.speed, s.t, s.deepest_w * s.deepest_w
            out[PEAK] = s.peak_force
            if largest_lossy == 0.0:
                return True
            first_moment = s.t * out[SUM] - out[MOMENT]  # ∫ θ Δ dθ; a_r acts along Δ, which ends at 0
            out[LOST] = 0.5 * (1.0 - s.speed * s.speed) - eta_1 * out[SUM] - 2.0 * eta_2 * first_moment - gamma * damped
            return True
    return False


class Contacts:
    """Integrator of single contacts of one law in dimensionless units, from which the table of the law is computed.

    The docstring of this module defines the arguments η_0, the acceleration at the touch, and η_1, η_2, α and γ, the
    perturbations.

    Args:
        parameters: one record of PARAMETERS with the constants of the law, except that stiffness and masses are 1; it
            is modified.
        law: the contact law's compiled force.
    """

    def __init__(self, parameters: Any, law: CompiledForce) -> None:
        self._parameters, self._law = parameters, law
        self._states, self._steps = record(STATE), record(CONTACT_STEP)

    def under(self, eta_0: float, perturbations: NDArray[np.float64]) -> tuple[bool, NDArray[np.float64]]:
        """Integrate a contact under η_0 and `perturbations`; return whether the sphere left the wall, and the outcome.

        The perturbations are (η_1, η_2, α, γ). The outcome has the shape (OUTCOMES,) and is valid only if the sphere
        left.
        """
        out = np.empty(OUTCOMES)
        left = perturbed_contact(self._parameters, self._law, eta_0, perturbations, self._states, self._steps, out)
        raise_failure()
        return left, out

    def derivatives(self, eta_0: float, which: int) -> tuple[bool, NDArray[np.float64], NDArray[np.float64]]:
        """Compute the first two derivatives of the outcomes f by one perturbation at η_0; return (left, f', ½ f'').

        `which` is the index of the perturbation in (η_1, η_2, α, γ). The derivatives are differences between three
        contacts, and `left` states whether the sphere left the wall in all three.
        """
        perturbations = np.zeros(4)
        left, plain = self.under(eta_0, perturbations)
        perturbation = MOST_1 if which == 0 else _PERTURBATION
        perturbations[which] = perturbation
        left_up, up = self.under(eta_0, perturbations)
        perturbations[which] = -perturbation
        left_down, down = self.under(eta_0, perturbations)
        half_second = 0.5 * (up + down - 2.0 * plain) / (perturbation * perturbation)
        return left and left_up and left_down, (up - down) / (2.0 * perturbation), half_second

    def rebound_squared(self, eta_0: float) -> float:
        """Return the square of the speed with which the sphere leaves under η_0, or 0 if it does not leave by itself.

        The unit of the speed is the approach speed.
        """
        left, out = self.under(eta_0, np.zeros(4))
        return float(out[SEPARATION] * out[SEPARATION]) if left else 0.0


def tabulate(parameters: Any, law: CompiledForce) -> Any:
    """Return the table of contact outcomes of a law, dtype TABLE, shape (1,).

    The table covers a range of η_0, the dimensionless acceleration at the touch. The range starts as ± WIDEST. It is
    narrowed until the sphere rebounds fast enough at both ends and the series of `_series` are exact enough. If no
    tried range suffices, `high` is 0, and every contact of the law is integrated.

    Args:
        parameters: one record of PARAMETERS with the constants of the law, except that stiffness and masses are 1; it
            is modified.
        law: the contact law's compiled force.
    """
    table, contacts = record(TABLE), Contacts(parameters, law)
    parameters[0].rtol = RTOL
    least = _WEAKEST * contacts.rebound_squared(0.0)
    low, high = -WIDEST, WIDEST
    for _ in range(_NARROWINGS):
        fits = contacts.rebound_squared(_MARGIN * low) > 0.0, contacts.rebound_squared(high) > least
        if all(fits):
            series = _series(contacts, (low, high))
            if series is not None:
                table.series[0], table.low[0], table.high[0] = series, low, high
                return table
            fits = False, False
        low, high = low if fits[0] else _NARROWER * low, high if fits[1] else _NARROWER * high
    return table


def _series(contacts: Contacts, limits: tuple[float, float]) -> NDArray[np.float64] | None:
    """Return the Chebyshev series of outcomes and their derivatives over a range of η_0, or None.

    The shape is (COEFFICIENTS, SERIES_COUNT). The result is None if the range is too wide: the sphere does not leave
    the wall in some integrated contact, or the last coefficients of the DECISIVE outcomes are not negligible. The
    series of derivatives have fewer terms than the series of outcomes.
    """
    series = np.zeros((COEFFICIENTS, SERIES_COUNT))

    def fill(count: int, columns: slice, outcome: Callable[[float], tuple[bool, NDArray[np.float64]]]) -> bool:
        found = [outcome(eta_0) for eta_0 in _nodes(limits, count)]
        series[:count, columns] = _chebyshev(np.array([values for _, values in found]))
        return all(ended for ended, _ in found)

    def by(which: int, quantities: int) -> Callable[[float], tuple[bool, NDArray[np.float64]]]:
        def outcome(eta_0: float) -> tuple[bool, NDArray[np.float64]]:
            ended, first, second = contacts.derivatives(eta_0, which)
            return ended, first[:quantities] if which else np.concatenate([first, second[:DECISIVE]])

        return outcome

    plain = fill(COEFFICIENTS, slice(OUTCOMES), lambda eta_0: contacts.under(eta_0, np.zeros(4)))
    decisive = np.abs(series[:, :DECISIVE])
    if not plain or (decisive[-2:] > _TAIL * decisive.max(axis=0)).any():
        return None
    start = 2 * OUTCOMES
    complete = fill(_COEFFICIENTS_1, slice(OUTCOMES, start + DECISIVE), by(0, OUTCOMES))
    for which in (BY_ETA_2, BY_STIFFNESS, BY_DAMPING):
        columns = slice(start + which * DECISIVE, start + (which + 1) * DECISIVE)
        complete &= fill(_COEFFICIENTS_2, columns, by(which, DECISIVE))
    return series if complete else None


def _nodes(limits: tuple[float, float], count: int) -> list[float]:
    """Return the `count` values of η_0 within `limits` that determine a Chebyshev series of `count` terms.

    The largest value is first. η_0 is the dimensionless acceleration that presses sphere and wall together at the
    touch.
    """
    middle, half = 0.5 * (limits[0] + limits[1]), 0.5 * (limits[1] - limits[0])
    return [middle + half * sincos(PI * (j + 0.5) / count)[1] for j in range(count)]


def _chebyshev(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the coefficients of the Chebyshev series through `values` at the Chebyshev nodes, one series per column.

    `values` and the result have the shape (number of nodes, columns).
    """
    series, count = np.zeros_like(values), len(values)
    for n in range(count):
        for j in range(count):
            cosine = sincos(n * PI * (j + 0.5) / count)[1]
            series[n] += values[j] * (cosine * (1.0 if n == 0 else 2.0) / count)
    return series


@kernel
def look_up(p: Record, table: Record, s: Record, step: Record, t_0: float, time_left: float) -> bool:
    """Compute the outcome of the contact that begins in the state s from the table; return whether it may be used.

    The outcome is stored in `table.outcome`, in units made of m_eff, v0 and t_0. It may be used if the approach is not
    slower than `speed_floor` and the contact is in the range of the table. The contact must also end within `time_left`
    seconds, and while the polynomials of `step` are exact. `step` must be expanded about s, and `t_0` is the contact's
    time scale [s].
    """
    speed = s.speed
    if speed < p.speed_floor:  # a limited approach speed would be a scale of its own
        return False
    eta_0 = step.acceleration[0] * t_0 / speed
    scale = t_0 * t_0 / speed
    eta_1, eta_2 = step.acceleration[1] * scale, step.acceleration[2] * scale * t_0
    eta_3 = step.acceleration[3] * scale * t_0 * t_0
    alpha, gamma = p.slowing_by_depth * t_0 * t_0, p.slowing_by_speed * t_0
    if not table.low <= eta_0 <= table.high or max(abs(eta_2), alpha, gamma) > MOST_2:
        return False
    if abs(eta_1) > MOST_1 or abs(eta_3) > MOST_3:
        return False
    x = (2.0 * eta_0 - table.high - table.low) / (table.high - table.low)
    value, series = table.value, table.series
    previous, chebyshev = 1.0, x  # T_0, T_1 and so on
    for j in range(SERIES_COUNT):
        value[j] = series[0, j] + series[1, j] * x
    for n in range(2, COEFFICIENTS):
        previous, chebyshev = chebyshev, 2.0 * x * chebyshev - previous
        for j in range(SERIES_COUNT):
            value[j] += series[n, j] * chebyshev
    for q in range(OUTCOMES):
        table.outcome[q] = value[q] + eta_1 * value[OUTCOMES + q]
    further_derivatives = value[2 * OUTCOMES :]
    for q in range(DECISIVE):
        table.outcome[q] += (
            eta_1 * eta_1 * further_derivatives[BY_ETA_1_SQUARED * DECISIVE + q]
            + eta_2 * further_derivatives[BY_ETA_2 * DECISIVE + q]
            + alpha * further_derivatives[BY_STIFFNESS * DECISIVE + q]
            + gamma * further_derivatives[BY_DAMPING * DECISIVE + q]
        )
    return table.outcome[DURATION] * t_0 < min(time_left, step.valid_for)


@kernel
def apply_outcome(p: Record, table: Record, s: Record, step: Record, t_0: float) -> None:
    """Move the state s from the touch to the end of its contact, by the outcome that `look_up` stored in the table.

    Duration, impulse, peak force, largest indentation and lost energy of the contact are set in s as well. `step` must
    be expanded about s, and `t_0` is the contact's time scale [s].
    """
    found, speed = table.outcome, s.speed
    delta_0 = speed * t_0
    duration, separation = found[DURATION] * t_0, found[SEPARATION] * speed
    columns_impulse = p.k_1 * found[SUM] * delta_0 * t_0  # ∫ F_z dt [N s]
    columns_impulse_integral = (
        p.k_1 * found[MOMENT] * delta_0 * t_0 * t_0 + p.c_1 * found[SUM] * delta_0 * t_0
    )  # ∫∫ F_z dt dt [N s²]
    v_2_before = s.y[V1] + s.side * (1.0 - p.share) * speed
    pair_at(step, duration, s.y)
    # the correction z to first order: `look_up` has checked that the next order is negligible
    signed_share = s.side * p.share
    s.y[V1] += signed_share * columns_impulse * p.per_m_pair
    s.y[X1] += signed_share * columns_impulse_integral * p.per_m_pair
    s.y[VB] -= signed_share * columns_impulse * p.per_m_base
    s.y[XB] -= signed_share * columns_impulse_integral * p.per_m_base
    s.impulse = -s.side * p.m * (s.y[V1] - s.side * (1.0 - p.share) * separation - v_2_before)
    s.elapsed = duration
    s.peak_force = found[PEAK] * p.m_eff * speed / t_0
    s.lost = found[LOST] * p.m_eff * speed * speed
    s.deepest_w = math.sqrt(found[DEPTH] * delta_0)
    s.w, s.speed = 0.0, -separation
    s.t += duration
