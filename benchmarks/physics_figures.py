"""Draw the figures that docs/physics.md names into build/figures: `python -m benchmarks.physics_figures`."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("agg")

import numpy as np
from matplotlib import pyplot as plt

from impact_rig.physics import SEGMENT, Motion, Simulation, restitution
from impact_rig.physics.contact import LAWS
from impact_rig.physics.model import CONTACT_RTOL
from impact_rig.physics.properties import hertz_stiffness_n_m32, sphere_mass_kg
from impact_rig.rig.config import RigConfig, from_flat

FOLDER = Path("build") / "figures"
SPEED_M_S, GAP_M = 0.3, 1e-3
HEAVY_KG = 100.0  # a wall that hardly moves


def one_contact(law: str, rtol: float = CONTACT_RTOL) -> tuple[Simulation, Motion]:
    """Let the sphere meet the right wall at 0.3 m/s."""
    config = from_flat(
        RigConfig(),
        {
            "drive.kind": "prescribed",
            "contact.law": law,
            "barriers.gap_m": GAP_M,
            "structure.mass_kg": HEAVY_KG,
            "structure.natural_frequency_hz": 1e-3,
        },
    )
    simulation = Simulation(config, rtol=rtol)
    simulation.place(d_rate=SPEED_M_S)
    drive = np.zeros(1, SEGMENT)
    drive["duration"], drive["omega"] = 0.5 * GAP_M / SPEED_M_S + 200e-6, 1.0
    return simulation, simulation.advance(drive)


def contact_laws() -> None:
    """Force over indentation of every compliant law."""
    figure, axes = plt.subplots(figsize=(7.0, 4.5), layout="constrained")
    for law in LAWS:
        simulation, motion = one_contact(law)
        hit = motion.impacts[0]
        if hit["duration"] == 0.0:
            continue  # instantaneous: nothing to draw
        t = hit["offset"] + np.linspace(0.0, 1.0, 400)[1:-1] * hit["duration"]
        x_1, x_2, force = motion.quantities(("x_1", "x_2", "force_right"), np.zeros(len(t), int), t)
        label = f"{law}: {simulation.realised_restitution:.3f}"
        axes.plot(1e6 * (x_2 - x_1 - 0.5 * GAP_M), force, label=label, linewidth=2.5 if law == "flores" else 1.0)
    axes.set(
        xlabel="indentation [µm]", ylabel="force [N]", title="One contact at 0.3 m/s, e = 0.35: law and what it returns"
    )
    axes.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.savefig(FOLDER / "contact_laws.png", dpi=120)


def contact_order() -> None:
    """Error of the returned speed over the number of steps: ours, and RK4 on the equations as they are written."""
    config = RigConfig()
    factor = LAWS["flores"](0.35).hysteresis_factor()
    exact = restitution.realised(factor)
    ours = []
    for rtol in 10.0 ** -np.arange(1.0, 14.0):
        _, motion = one_contact("flores", rtol)
        hit = motion.impacts[0]
        ours.append((motion.in_contact().sum() - 1, abs(hit["separation_speed"] / hit["approach_speed"] / exact - 1.0)))
    k = hertz_stiffness_n_m32(config.sphere, config.barriers) / sphere_mass_kg(config.sphere)
    counts = np.unique(np.geomspace(10, 3000, 25).astype(int))
    classical = [abs(_rk4(k, factor, int(n)) / exact - 1.0) for n in counts]
    figure, axes = plt.subplots(figsize=(7.0, 4.5), layout="constrained")
    axes.loglog(*zip(*ours, strict=True), "o-", label="collocation in √δ and s, tolerance 1e-1 … 1e-13")
    axes.loglog(counts, classical, "s-", label="RK4 in δ and t, equal steps")
    axes.loglog(counts, classical[8] * (counts / counts[8]) ** -2.5, "k:", label="order 2.5")
    axes.set(
        xlabel="steps per contact", ylabel="relative error of the returned speed", title="Flores, e = 0.35, 0.3 m/s"
    )
    axes.legend()
    figure.savefig(FOLDER / "contact_order.png", dpi=120)


def _rk4(k: float, factor: float, steps: int) -> float:
    def rates(y: np.ndarray) -> np.ndarray:
        return np.array([y[1], -k * max(y[0], 0.0) ** 1.5 * (1.0 + factor * y[1] / SPEED_M_S)])

    y, h = np.array([0.0, SPEED_M_S]), 60e-6 / steps  # to beyond the release
    for _ in range(steps):
        a = rates(y)
        b = rates(y + 0.5 * h * a)
        c = rates(y + 0.5 * h * b)
        y = y + h / 6.0 * (a + 2.0 * b + 2.0 * c + rates(y + h * c))
    return float(-y[1] / SPEED_M_S)


if __name__ == "__main__":
    FOLDER.mkdir(parents=True, exist_ok=True)
    contact_laws()
    contact_order()
