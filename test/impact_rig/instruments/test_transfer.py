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
"""Partial fractions compared with their transfer functions, and the response of a mode compared with quadrature."""

import numpy as np
import pytest
from kits.instruments import configured
from scipy import integrate, signal

from impact_rig.arithmetic.interpolation import NODES
from impact_rig.instruments import sensor as transfer
from impact_rig.instruments.chain import sensors
from impact_rig.instruments.response import SERIES_TERMS, mode_records, set_period, through_piece
from impact_rig.kernels import with_fields

FREQUENCIES = np.geomspace(0.1, 60e3, 50)


def chains():
    return [
        pytest.param(sensor.transfer, id=f"{sensor.name}, anti-alias {anti_alias}")
        for anti_alias in ("none", "butterworth")
        for sensor in sensors(configured(adc__anti_alias=anti_alias))
    ]


@pytest.mark.parametrize("chain", chains())
def test_the_sum_of_the_modes_is_the_transfer_function(chain):
    modes = chain.modes()
    s = 2j * np.pi * FREQUENCIES[:, None]
    pairs = modes.poles.imag > 0
    own = modes.residues / (s - modes.poles)
    conjugate = modes.residues.conj() / (s - modes.poles.conj())
    total = np.sum(np.where(pairs, 0.5 * (own + conjugate), own), axis=1)
    np.testing.assert_allclose(total, chain.response(FREQUENCIES), rtol=1e-8, atol=1e-10)


def test_butterworth_and_lag_agree_with_scipy():
    for order in (1, 2, 3, 8):
        b, a = signal.butter(order, 2 * np.pi * 1e3, analog=True)
        _, expected = signal.freqs(b, a, 2 * np.pi * FREQUENCIES)
        np.testing.assert_allclose(transfer.butterworth(order, 1e3).response(FREQUENCIES), expected, rtol=1e-9)
    _, expected = signal.freqs([1.0], [0.7e-3, 1.0], 2 * np.pi * FREQUENCIES)
    np.testing.assert_allclose(transfer.lag(0.7e-3).response(FREQUENCIES), expected, rtol=1e-12)


def test_the_peak_of_a_resonance_is_its_quality_factor():
    sensor = transfer.resonance(25e3, 30.0)
    assert abs(sensor.response(25e3)) == pytest.approx(30.0)
    assert abs(sensor.response(1.0)) == pytest.approx(1.0, rel=1e-8)


def test_equal_poles_are_handled():
    twice = transfer.lag(1e-3) * transfer.lag(1e-3)
    modes = twice.modes()
    impulse = np.sum((modes.residues * np.exp(modes.poles * 1e-3)).real)
    assert impulse == pytest.approx(1e-3 / 1e-3**2 * np.exp(-1.0), rel=1e-4)  # t/τ² e^{-t/τ} at t = τ


def test_the_delay_is_the_slope_of_the_phase():
    for sensor in sensors(configured()):
        low = sensor.low_pass
        slope = -np.angle(low.response(0.1)) / (2 * np.pi * 0.1)
        assert low.delay_s() == pytest.approx(float(slope), rel=1e-6)


@pytest.mark.parametrize("scale", [1e-4, 0.05, 0.3, 0.499, 0.501, 1.9, 2.1, 15.0, 80.0])
@pytest.mark.parametrize("direction", [-1.0, -0.02 + 1j, -0.7 + 0.7j])
def test_the_response_of_a_mode_to_a_polynomial_is_the_integral(scale, direction):
    """z(t) = e^{pt} z_0 + ∫ e^{p (t − s)} u(s) ds at five conversions and at the end, for any p h."""
    length = 1e-4
    pole = np.array([scale * direction / length], complex)
    residue, start = np.array([0.7 - 0.4j]), 1e-5 - 2e-5j
    modes = with_fields(mode_records(pole, residue))
    modes["psi_re"], modes["psi_im"] = start.real, start.imag
    u = np.random.default_rng(1).normal(size=NODES) / 4.0 ** np.arange(NODES)
    first, period, out = 0.13 * length, 0.2 * length, np.zeros(5)
    set_period(modes, period)
    through_piece(modes, u, length, np.array([first, period]), np.zeros((3, SERIES_TERMS)), out)

    def exact(t):
        def integrand(s, part):
            value = np.exp(pole[0] * (t - s)) * np.polyval(u[::-1], 2 * s / length - 1)
            return value.real if part == 0 else value.imag

        driven = [integrate.quad(integrand, 0, t, (part,), epsabs=1e-18, epsrel=1e-12, limit=200)[0] for part in (0, 1)]
        return start * np.exp(pole[0] * t) + complex(*driven)

    expected = [(residue[0] * exact(first + m * period)).real for m in range(5)]
    np.testing.assert_allclose(out, expected, atol=1e-11 * np.max(np.abs(expected)) + 1e-16)
    end = complex(modes["psi_re"][0], modes["psi_im"][0])
    assert end == pytest.approx(exact(length), rel=1e-10, abs=1e-11 * length)
