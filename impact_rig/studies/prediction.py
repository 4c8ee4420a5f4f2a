# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Prediction and measurement side by side: the same rig once in closed form and once through its instruments."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import attrs
import numpy as np

from impact_rig.campaign.job import Job, Outcome
from impact_rig.campaign.paper import CURRENT_A
from impact_rig.campaign.run import Runner
from impact_rig.operate.plan import Direction
from impact_rig.physics import prediction

__all__ = ["CURRENT_A", "Compared", "compared", "job", "side_by_side"]
NAN = math.nan


@attrs.frozen(kw_only=True)
class Compared:
    """One place, measured and predicted; NaN where there is no measurement, or no such motion.

    Attributes:
        frequency_hz: of the drive.
        gap_m: gap.
        dt: measured.
        phase_rad: measured, superior base to base.
        impacts_per_cycle: measured.
        regime: the word for the response; empty where nothing was measured.
        period: cycles after which it repeats.
        predicted_dt: of the stable motion with two symmetric impacts per cycle.
        predicted_phase_rad: its phase.
    """

    frequency_hz: float
    gap_m: float
    dt: float
    phase_rad: float
    impacts_per_cycle: float
    regime: str
    period: float
    predicted_dt: float
    predicted_phase_rad: float

    @property
    def two_per_cycle(self) -> bool:
        """Whether the measurement repeats every cycle with two impacts; the two half cycles may differ."""
        return self.regime == "periodic" and self.period == 1.0 and abs(self.impacts_per_cycle - 2.0) < 0.05

    @property
    def predicted(self) -> bool:
        """Whether a stable symmetric motion is predicted."""
        return not math.isnan(self.predicted_dt)


def job(frequency_hz: float, gap_m: float, current_a: float = CURRENT_A) -> Job:
    """Return the measurement of one place of the default rig."""
    return Job(
        changes={"barriers.gap_m": gap_m},
        analysis={},
        gap_m=gap_m,
        frequencies_hz=(frequency_hz,),
        direction=Direction.UP,
        current_a=current_a,
        repetitions=1,
        traces=False,
    )


def compared(one: Job, outcome: Outcome) -> Compared:
    """Return a job's measurement beside its prediction."""
    frequency, rows = one.frequencies_hz[0], outcome.rows
    predicted = prediction.at(one.config(), frequency, one.gap_m, current_a=one.current_a)
    stable = np.flatnonzero(predicted.stable)
    measured = len(rows) > 0
    return Compared(
        frequency_hz=frequency,
        gap_m=one.gap_m,
        dt=float(rows["transmissibility"][0]) if measured else NAN,
        phase_rad=float(rows["phase"][0]) if measured else NAN,
        impacts_per_cycle=float(rows["impacts_per_cycle"][0]) if measured else NAN,
        regime=rows["regime"][0].decode() if measured else "",
        period=float(rows["period"][0]) if measured else NAN,
        predicted_dt=float(predicted.dt[stable[0]]) if len(stable) else NAN,
        predicted_phase_rad=float(predicted.phase_rad[stable[0]]) if len(stable) else NAN,
    )


def side_by_side(places: Iterable[tuple[float, float]], runner: Runner) -> Sequence[Compared]:
    """Return measurement and prediction at (frequency [Hz], gap [m]), in that order."""
    jobs = [job(frequency, gap) for frequency, gap in places]
    found = {one.key: compared(one, outcome) for one, outcome in runner(jobs)}
    return [found[one.key] for one in jobs]
