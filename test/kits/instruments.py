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
"""Motions known in closed form, and configurations without errors, with which the instruments are compared.

`AnalyticMotion` shares no code with the physics: quantities are formulas in t, and breakpoints are exact.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import signal

from impact_rig.arithmetic.interpolation import polynomials
from impact_rig.instruments import Chain
from impact_rig.instruments.sensor import Transfer
from impact_rig.rig.config import RigConfig, from_flat

TICK_S = 0.01
IMPACT = np.dtype([("tick", "i8"), ("offset", "f8"), ("wall", "i1"), ("impulse", "f8"), ("duration", "f8")])

EXACT = {
    "instruments.accelerometer.noise_v_rms": 0,
    "instruments.accelerometer.gain_tolerance": 0,
    "instruments.accelerometer.offset_tolerance_v": 0,
    "instruments.laser.noise_m_rms": 0,
    "instruments.laser.resolution_m": 0,
    "instruments.laser.linearity_m": 0,
    "instruments.laser.gain_tolerance": 0,
    "instruments.laser.offset_tolerance_m": 0,
    "instruments.base.noise_m_rms": 0,
    "instruments.base.linearity": 0,
    "instruments.base.gain_tolerance": 0,
    "instruments.base.offset_tolerance_m": 0,
    "instruments.current.noise_a_rms": 0,
    "instruments.current.gain_tolerance": 0,
    "instruments.current.offset_tolerance_a": 0,
    "instruments.adc.noise_v_rms": 0,
    "instruments.adc.gain_tolerance": 0,
    "instruments.adc.offset_tolerance": 0,
    "instruments.adc.bits": 24,
}
"""Instruments with their dynamics and skew, but without noise, errors and (nearly) without quantisation."""


def configured(rate_hz: int = 10_000, exact: bool = False, **changes: object) -> RigConfig:
    """Return a configuration; keyword `laser__lag_s` changes `instruments.laser.lag_s`."""
    named = {f"instruments.{key.replace('__', '.')}": value for key, value in changes.items() if key != "seed"}
    seed = {"daq.seed": changes["seed"]} if "seed" in changes else {}
    return from_flat(RigConfig(), {"daq.rate_hz": rate_hz, **(EXACT if exact else {}), **named, **seed})


class AnalyticMotion:
    """Motion given by formulas of t; quantities without a formula are zero."""

    def __init__(
        self,
        breakpoints: tuple[float, ...] | np.ndarray = (),
        impacts: np.ndarray | None = None,
        tick_s: float = TICK_S,
        **formulas: Callable[[np.ndarray], np.ndarray],
    ) -> None:
        self.impacts = np.zeros(0, dtype=IMPACT) if impacts is None else impacts
        self._tick_s = tick_s
        self._formulas = formulas
        at = np.sort(np.asarray(breakpoints, dtype=float))
        segment = np.floor(at / tick_s).astype(np.int64)
        self._breakpoints = segment, at - segment * tick_s

    def breakpoints(self) -> tuple[np.ndarray, np.ndarray]:
        return self._breakpoints

    def quantities(self, names: tuple[str, ...], segment: np.ndarray, offset_s: np.ndarray) -> np.ndarray:
        t = segment * self._tick_s + offset_s
        return np.stack([self._formulas.get(name, np.zeros_like)(t) for name in names])

    def polynomials(
        self, names: tuple[str, ...], segment: np.ndarray, start_s: np.ndarray, end_s: np.ndarray
    ) -> np.ndarray:
        return polynomials(lambda at, offset: self.quantities(names, at, offset), segment, start_s, end_s)


def sine(frequency_hz: float, amplitude: float, phase: float = 0.0) -> Callable[[np.ndarray], np.ndarray]:
    return lambda t: amplitude * np.sin(2 * np.pi * frequency_hz * t + phase)


def hertz_pulse(start_s: float, duration_s: float, peak: float) -> Callable[[np.ndarray], np.ndarray]:
    """Force like that of a contact: δ^1.5 with δ half a sine, and kinks of power 1.5 at both ends."""

    def force(t: np.ndarray) -> np.ndarray:
        return peak * np.sin(np.pi * np.clip((t - start_s) / duration_s, 0.0, 1.0)) ** 1.5

    return force


def steps_of(start_s: float, duration_s: float, steps: int = 12) -> np.ndarray:
    """Breakpoints of a contact that was integrated in this number of steps."""
    return start_s + duration_s * np.arange(steps + 1) / steps


def measured(chain: Chain, motion: object, seconds: float, ticks_per_call: int = 50) -> np.ndarray:
    """Return the scans of the first seconds of a motion."""
    total = round(seconds / TICK_S)
    rows = []
    for first in range(0, total, ticks_per_call):
        chain.acquire(motion, first, min(ticks_per_call, total - first))
        rows.append(chain.read(chain.ready))
    scans = np.concatenate(rows)
    scans["time"] = np.arange(len(scans)) / chain.config.daq.rate_hz
    return scans


def fitted(time_s: np.ndarray, values: np.ndarray, frequency_hz: float) -> complex:
    """Return the complex amplitude A of Im[A exp(jωt)] in the values."""
    angle = 2 * np.pi * frequency_hz * time_s
    basis = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)
    found = np.linalg.lstsq(basis, values, rcond=None)[0]
    return complex(found[0], found[1])


def filtered(transfer: Transfer, time_s: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the response of a transfer function to densely sampled values, by SciPy's state space."""
    scale = 1e5  # time in tens of microseconds keeps the state matrix well conditioned
    order = len(transfer.poles) - len(transfer.zeros)
    zeros, poles = (np.array([complex(place) for place in places]) for places in (transfer.zeros, transfer.poles))
    system = signal.ZerosPolesGain(zeros / scale, poles / scale, float(transfer.gain) / scale**order)
    return signal.lsim(system.to_ss(), values, (time_s - time_s[0]) * scale)[1]
