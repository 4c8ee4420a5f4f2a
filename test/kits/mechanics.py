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
"""Helpers for tests of the mechanics: short definitions of rigs, drive segments, a lock-in, one contact."""

from __future__ import annotations

import math

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.physics import SEGMENT, Motion, Simulation
from impact_rig.physics.contact import LAWS
from impact_rig.physics.contact.hunt_crossley import HystereticLaw
from impact_rig.physics.linear import hertz_stiffness_n_m32, sphere_mass_kg
from impact_rig.rig.config import RigConfig

TWO_PI = 2.0 * math.pi
OF_HYSTERETIC_FORM = tuple(name for name, law in LAWS.items() if issubclass(law, HystereticLaw))


def rig(**sections: dict[str, object]) -> RigConfig:
    """Return the nominal rig with other values: `rig(contact={"law": "hertz"})`."""
    nominal = RigConfig()
    changed = {name: attrs.evolve(getattr(nominal, name), **new) for name, new in sections.items()}
    return attrs.evolve(nominal, **changed)


def limit_case(**sections: dict[str, object]) -> RigConfig:
    """Return the same beyond the ranges of a configuration: a wall that never moves, a contact that hardly yields."""
    with attrs.validators.disabled():
        return rig(**sections)


def prescribed(**sections: dict[str, object]) -> RigConfig:
    """Return the same on a prescribed base."""
    sections["drive"] = {"kind": "prescribed"} | sections.get("drive", {})
    return rig(**sections)


def benchmark_rig(**sections: dict[str, object]) -> RigConfig:
    """Return the benchmark problem of the peers: prescribed base, ζ = 0.0045."""
    return prescribed(structure={"damping_ratio": 0.0045}, **sections)


def sine(
    frequency_hz: float, amplitude: float, duration_s: float, count: int = 1, phase: float = 0.0, first: int = 0
) -> NDArray[np.void]:
    """Return `count` segments of a sine, without jumps of phase, from segment number `first` on."""
    rows = np.zeros(count, SEGMENT)
    rows["duration"] = duration_s
    rows["omega"] = TWO_PI * frequency_hz
    turns = np.fmod(frequency_hz * duration_s * np.arange(first, first + count), 1.0)
    rows["phase"] = phase + TWO_PI * turns
    rows["amplitude"] = amplitude
    return rows


def at_rest(duration_s: float, count: int = 1) -> NDArray[np.void]:
    """Return segments without drive."""
    return sine(1.0, 0.0, duration_s, count)


def of(motion: Motion, name: str, times: NDArray[np.float64], segment: int | None = None) -> NDArray[np.float64]:
    """Return one quantity at offsets [s] into one segment."""
    number = motion.first_tick if segment is None else segment
    return motion.quantity(name, np.full(len(times), number), np.asarray(times, float))


def lock_in(
    motion: Motion, name: str, frequency_hz: float, start_s: float, cycles: int, per_cycle: int = 64
) -> complex:
    """Return the complex amplitude X of Im[X exp(jωt)] over whole cycles of one segment; t counts from its start."""
    t = start_s + np.arange(cycles * per_cycle) / (per_cycle * frequency_hz)
    x = of(motion, name, t)
    return complex(2j * np.mean(x * np.exp(-1j * TWO_PI * frequency_hz * t)))


def gauss(begin: NDArray[np.float64], end: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return Gauss's instants and weights [s] to integrate over each piece in a stretched time, shapes (pieces, 48).

    A force begins and ends with the power 1.5 of time; with t ~ 3u² − 2u³, it is smooth in u there as well.
    """
    nodes, weights = np.polynomial.legendre.leggauss(48)
    u = 0.5 * (1.0 + nodes)
    length = (end - begin)[:, np.newaxis]
    return begin[:, np.newaxis] + length * (u * u * (3.0 - 2.0 * u)), length * (3.0 * u * (1.0 - u) * weights)


def transmissibility(config: RigConfig, frequency_hz: float) -> complex:
    """Return X_1 / X_b of the linear rig, complex, by the textbook's formula."""
    r, zeta = frequency_hz / config.structure.natural_frequency_hz, config.structure.damping_ratio
    return (1.0 + 2j * zeta * r) / (1.0 - r * r + 2j * zeta * r)


@attrs.frozen
class Hit:
    """One simulated contact: its row of `truth/impacts`, and the motion around it."""

    approach_speed: float
    separation_speed: float
    peak_force: float
    peak_indentation: float
    impulse: float
    duration: float
    energy_lost: float
    motion: Motion
    begin_s: float

    @property
    def restitution(self) -> float:
        """Separation speed divided by approach speed."""
        return self.separation_speed / self.approach_speed


def hit(speed_m_s: float, *, structure_kg: float = 1e9, rtol: float | None = None, **contact: object) -> Hit:
    """Let the sphere meet the right wall of a structure at rest on very soft columns, without drive and weight."""
    config = limit_case(
        drive={"kind": "prescribed"},
        structure={"mass_kg": structure_kg, "natural_frequency_hz": 1e-4},
        barriers={"gap_m": 1e-3},
        contact=contact,
    )
    options = {} if rtol is None else {"rtol": rtol}
    simulation = Simulation(config, **options)
    travel_s = 0.5e-3 / speed_m_s
    simulation.place(d_rate=speed_m_s)
    motion = simulation.advance(at_rest(1.5 * travel_s + 1e-3 / speed_m_s**0.2))
    assert len(motion.impacts) >= 1, "the sphere did not return from the wall"
    row = motion.impacts[0]
    values = {name: float(row[name]) for name in row.dtype.names if name not in ("tick", "offset", "wall")}
    return Hit(**values, motion=motion, begin_s=float(row["offset"]))


def sphere_kg(config: RigConfig | None = None) -> float:
    """Return the mass of the sphere [kg]."""
    return sphere_mass_kg((config or RigConfig()).sphere)


def stiffness(config: RigConfig | None = None) -> float:
    """Return the Hertz stiffness of sphere and barrier [N/m^1.5]."""
    config = config or RigConfig()
    return hertz_stiffness_n_m32(config.sphere, config.barriers)
