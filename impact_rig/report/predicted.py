# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What theory says without simulation, as lines: closed form without the sphere, two impacts per cycle with it."""

from __future__ import annotations

from collections.abc import Sequence

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.campaign.axes import NO_SPHERE
from impact_rig.drawing.style import Line
from impact_rig.errors import ConfigError
from impact_rig.physics import prediction
from impact_rig.physics.prediction import transmissibility
from impact_rig.rig.config import RigConfig, from_flat


@attrs.frozen(eq=False)
class Stretch:
    """A line without a break; every attribute has the shape (n,).

    Attributes:
        frequency_hz: ascending.
        dt: transmissibility.
        phase_rad: of the superior base to the inferior one.
    """

    frequency_hz: NDArray[np.float64]
    dt: NDArray[np.float64]
    phase_rad: NDArray[np.float64]


def predicted(
    config: RigConfig, gap_m: float, frequencies_hz: NDArray[np.float64], current_a: float
) -> Sequence[Stretch]:
    """Return the prediction for a gap, or `NO_SPHERE`, at constant current; nothing where no theory holds.

    Args:
        config: the rig; its own gap does not matter.
        gap_m: gap.
        frequencies_hz: ascending, shape (n,).
        current_a: peak.
    """
    if gap_m == NO_SPHERE:
        ratio = transmissibility(config, frequencies_hz)
        return [Stretch(frequencies_hz, np.abs(ratio), np.angle(ratio))]
    try:
        rig = from_flat(config, {"sphere.present": True, "barriers.gap_m": gap_m})
        branches = prediction.curves(rig, frequencies_hz, gap_m, current_a=current_a)
    except ConfigError:  # outside of what the theory holds for: friction, no loss, ...
        return []
    return [part for one in branches for part in _lasting(one)]


def reduction_over_gap(config: RigConfig, frequency_hz: float, current_a: float) -> Line | None:
    """Return the predicted reduction of DT by gap at one frequency and constant current; None where no theory holds.

    Args:
        config: the rig; its own gap does not matter.
        frequency_hz: of the drive.
        current_a: peak.
    """
    try:
        rig = from_flat(config, {"sphere.present": True})
        found = prediction.branch(rig, frequency_hz, current_a=current_a)
    except ConfigError:  # as above
        return None
    lasting = np.flatnonzero(found.stable)
    order = lasting[np.argsort(found.gap_m[lasting])]
    if len(order) < 2:
        return None
    without = abs(complex(transmissibility(config, frequency_hz)))
    percent = 100.0 * (1.0 - found.dt[order] / without)
    return Line("predicted", {"gap_m": found.gap_m[order].tolist(), "reduction_percent": percent.tolist()})


def _lasting(branch: prediction.Branch) -> Sequence[Stretch]:
    """Return the stretches of a branch whose motion is stable."""
    stable = np.flatnonzero(branch.stable)
    runs = np.split(stable, np.flatnonzero(np.diff(stable) > 1) + 1)
    return [Stretch(branch.frequency_hz[i], branch.dt[i], branch.phase_rad[i]) for i in runs if len(i) > 1]
