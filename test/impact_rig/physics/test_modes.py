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
"""Modes and positions of rest, refined with many digits: what they must satisfy, and what must not decide them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from impact_rig.errors import ConfigError
from impact_rig.physics import linear, model
from impact_rig.rig.config import RigConfig, from_flat

KINDS = ("prescribed", "current", "voltage")
LAST_DIGITS = 4.0 * np.finfo(float).eps


def matrix(kind: str, **values: float) -> np.ndarray:
    config = from_flat(RigConfig(), {key.replace("__", "."): value for key, value in values.items()})
    c = linear.constants(config)
    return linear.state_matrix(c, kind, c.m_1)


def scaled(m: np.ndarray) -> np.ndarray:
    """Return the matrix in units in which lengths and speeds are of one size."""
    units = np.ones(len(m))
    units[0 : len(m) - 1 : 2] = 1.0 / math.sqrt(-m[1, 0])
    return units[np.newaxis, :] / units[:, np.newaxis]


def test_one_mode_of_each_conjugate_pair_is_kept_slow_real_modes_first() -> None:
    modes = linear.modes(matrix("voltage"))
    assert modes.rate.imag[0] == 0.0
    assert np.all(np.diff(modes.rate.imag) > 0.0)


@pytest.mark.parametrize("kind", KINDS)
def test_modes_agree_with_those_of_lapack(kind: str) -> None:
    m = matrix(kind)
    there = np.linalg.eigvals(m)
    there = there[there.imag >= 0.0]
    there = there[np.argsort(there.imag)]
    np.testing.assert_allclose(linear.modes(m).rate, there, rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mass_kg", [1e-3, 0.13, 99.0])
def test_modes_sum_to_the_identity_and_the_matrix(kind: str, mass_kg: float) -> None:
    m = matrix(kind, structure__mass_kg=mass_kg)
    modes = linear.modes(m)
    projectors = [np.outer(right, left) for right, left in zip(modes.right, modes.left, strict=True)]
    identity = sum(p.real for p in projectors) * scaled(m)
    product = sum((rate * p).real for rate, p in zip(modes.rate, projectors, strict=True)) * scaled(m)
    size = max(np.abs(p * scaled(m)).max() for p in projectors)
    assert np.abs(identity - np.eye(len(m))).max() <= len(m) * LAST_DIGITS * size
    assert np.abs(product - m * scaled(m)).max() <= len(m) * LAST_DIGITS * size * np.abs(modes.rate).max()


@pytest.mark.parametrize("kind", KINDS)
def test_modes_do_not_depend_on_the_start_values_of_the_refinement(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    m = matrix(kind)
    exact = linear.modes(m)
    rough = np.linalg.eigvals
    for seed in range(5):
        rng = np.random.default_rng(seed)
        monkeypatch.setattr(
            np.linalg,
            "eigvals",
            lambda a, rng=rng: rng.permutation(rough(a) * (1.0 + 1e-3 * rng.standard_normal(len(a)))),
        )
        again = linear.modes(m)
        assert all(np.array_equal(new, old) for new, old in zip(again, exact, strict=True))


def test_coinciding_modes_of_critical_damping_are_separated() -> None:
    omega = 50.0
    m = np.array([[0.0, 1.0], [-omega * omega, -2.0 * omega]])
    modes = linear.modes(m)
    np.testing.assert_allclose(modes.rate, -omega, rtol=1e-4)
    assert modes.rate[0] != modes.rate[1]


def test_a_matrix_without_modes_is_rejected() -> None:
    with pytest.raises(ConfigError, match="separable"):
        linear.modes(np.zeros((2, 2)))
    with pytest.raises(ConfigError, match="structure and shaker have no modes"):
        linear.modes(np.array([[0.0, 1.0], [-math.inf, -1.0]]))


@pytest.mark.parametrize("kind", KINDS)
def test_the_static_response_balances_the_force(kind: str) -> None:
    m = matrix(kind)
    push = np.zeros(len(m))
    push[1] = 7.0
    rest = linear.static_answer(m, push)
    np.testing.assert_allclose(m @ rest, -push, rtol=0.0, atol=LAST_DIGITS * (np.abs(m) @ np.abs(rest)).max())


def test_a_rig_without_stiffness_has_no_static_response() -> None:
    with pytest.raises(ConfigError, match="rest"):
        linear.static_answer(np.array([[0.0, 1.0], [0.0, -1.0]]), np.array([0.0, 1.0]))


def test_a_change_of_the_gap_does_not_recompute_the_modes(monkeypatch: pytest.MonkeyPatch) -> None:
    config = RigConfig()
    before = model.build(config)
    monkeypatch.setattr(linear, "_refined", lambda _: pytest.fail("modes were computed again"))
    after = model.build(from_flat(config, {"barriers.gap_m": 0.0042}))
    assert after.parameters[0].half_gap == 0.0021
    assert after.systems is before.systems
