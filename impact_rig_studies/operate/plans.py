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
"""Plans of stepped sines and phase locks: points, controlled amplitude and tracked resonance, with their limits."""

from __future__ import annotations

import enum
from typing import Any

import attrs

from impact_rig.config.fields import Origin, choice, integer, quantities, quantity, switch
from impact_rig.errors import ConfigError


class Direction(enum.StrEnum):
    """Order of the frequencies of a sweep: ascending, descending, or both in this order without a reset of the rig."""

    UP = "up"
    DOWN = "down"
    UP_DOWN = "up_down"


def current_field() -> Any:
    """Return a new attrs field `current_a` for a plan: the peak amplitude of the drive [A] (m or V by `drive.kind`)."""
    return quantity(
        0.52,
        "A",
        "Peak amplitude of the drive: a current, or by drive.kind a displacement in m or a voltage in V. The default "
        "is meant for a current.",
        Origin.IDENTIFIED,
        above=0,
        at_most=1000,
    )


def superior_limit_field() -> Any:
    """Return a new attrs field `superior_limit_m` for a plan.

    It is the peak displacement of the superior base [m] above which a phase lock, or a sweep with a controlled
    amplitude, is aborted.
    """
    return quantity(
        0.05, "m", "Peak displacement of the superior base above which a controller aborts.", above=0, at_most=1
    )


@attrs.frozen(kw_only=True)
class SweepPlan:
    """Plan of a stepped sine: its points and limits.

    The fields are also parameters of the stepped-sine node.

    Raises:
        ConfigError: a value is invalid; the message names it.
    """

    frequencies_hz: tuple[float, ...] = quantities(
        (7.5, 8.0, 8.5, 8.9, 9.0, 9.1, 9.2, 9.5, 10.0, 10.5),
        "Hz",
        "Drive frequencies of the points, in any order; they are measured as one sweep in the order of direction.",
        Origin.PAPER,
        above=0,
        at_most=10_000,
    )
    current_a: float = current_field()
    direction: str = choice(
        "up",
        tuple(Direction),
        "Order of the frequencies: ascending, descending, or both one after the other without a reset of the rig.",
    )
    measurements_per_point: int = integer(
        1,
        "-",
        "Number of accepted measurements at each point: settled ones, and those that had not settled within the time "
        "limit of the analysis (the latter not if a stepped-sine node has keep_unsettled: false).",
        at_least=1,
        at_most=1000,
    )
    dwell_limit_s: float = quantity(
        150.0,
        "s",
        "Rig time after a command within which its point must be measured; otherwise the sweep is aborted.",
        above=0,
        at_most=1e9,
    )
    accept_limit_s: float = quantity(
        5.0,
        "s",
        "Rig time after which the sweep is aborted if the rig has not accepted a command.",
        above=0,
        at_most=1e5,
    )
    retries: int = integer(
        2,
        "-",
        "Number of failed measurements tolerated at each point; one more aborts the sweep, or skips the point if a "
        "sensor was over range and skip_over_range is true.",
        at_least=0,
        at_most=1000,
    )
    skip_over_range: bool = switch(True, "Skip a point where a sensor is over range, instead of aborting the sweep.")
    keep_unsettled: bool = switch(
        True,
        "Accept a response that has not settled within the time limit of the analysis; otherwise it counts as failed.",
    )

    def __attrs_post_init__(self) -> None:
        if len(set(self.frequencies_hz)) != len(self.frequencies_hz):
            repeated = next(one for one in self.frequencies_hz if self.frequencies_hz.count(one) > 1)
            raise ConfigError(
                f"frequencies_hz (--frequencies) must not repeat a frequency, got {repeated:g} Hz more than once"
            )

    def points(self) -> tuple[float, ...]:
        """Return the drive frequencies [Hz] in the order of measurement; for up_down each occurs twice."""
        up = tuple(sorted(self.frequencies_hz))
        down = up[::-1]
        return {Direction.UP: up, Direction.DOWN: down, Direction.UP_DOWN: up + down}[Direction(self.direction)]


class Hold(enum.StrEnum):
    """Quantity whose measured amplitude can be controlled: current, or displacement of inferior or superior base."""

    CURRENT = "current"
    BASE = "base"
    SUPERIOR = "superior"


@attrs.frozen(kw_only=True, slots=False)  # one of several bases of the node's parameters
class HoldPlan:
    """Plan of the control of an amplitude during a stepped sine: controlled quantity, target and limits.

    The fields are also parameters of the stepped-sine node.

    Raises:
        ConfigError: a value is invalid; the message names it.
    """

    hold: str = choice("base", tuple(Hold), "Quantity whose measured amplitude is controlled by adjusting the current.")
    target: float = quantity(
        60e-6,
        "m or A",
        "Peak amplitude to which the controlled quantity is adjusted; ignored if hold is command or phase.",
        above=0,
        at_most=1000,
    )
    tolerance: float = quantity(
        2e-3, "-", "Relative error up to which the amplitude counts as equal to the target.", above=0, at_most=0.5
    )
    corrections: int = integer(
        8, "-", "Maximum number of adjustments of the current at each point.", at_least=1, at_most=1000
    )
    current_limit_a: float = quantity(
        15.0,
        "A",
        "Largest peak current; the sweep is aborted if the target amplitude needs more.",
        above=0,
        at_most=1000,
    )
    superior_limit_m: float = superior_limit_field()


class Reference(enum.StrEnum):
    """Reference of the superior base's phase in a phase lock: motion of the inferior base, or current."""

    BASE = "base"
    CURRENT = "current"


def _amount(default: float, unit: str, doc: str) -> Any:
    return quantity(default, unit, doc, above=0)


@attrs.frozen(kw_only=True, slots=False)  # one of several bases of the node's parameters
class LockSettings:
    """Settings of a phase lock that are also parameters of the stepped-sine node."""

    reference: str = choice(
        "base",
        tuple(Reference),
        "Motion (of the inferior base) or current relative to which the phase of the superior base is measured.",
    )
    within_deg: float = quantity(
        2.0,
        "deg",
        "Deviation from -90 degrees, of the phase averaged over a second, up to which the phase is locked.",
        above=0,
        at_most=90,
    )
    dwell_s: float = quantity(
        30.0,
        "s",
        "Rig time from the first lock to the end of the run; if the lock is lost then, the run ends at the next lock.",
        above=0,
        at_most=1e9,
    )


@attrs.frozen(kw_only=True)
class LockPlan(LockSettings):
    """Plan of a phase lock: search for a resonance, tracking, and dwell time at the resonance.

    Raises:
        ConfigError: a value is invalid; the message names it.
    """

    start_hz: float = _amount(
        9.0, "Hz", "Drive frequency where the search for the resonance begins; the phase decides whether up or down."
    )
    current_a: float = current_field()
    low_hz: float = _amount(5.0, "Hz", "Lowest drive frequency of search and tracking.")
    high_hz: float = _amount(20.0, "Hz", "Highest drive frequency of search and tracking.")
    step_hz: float = _amount(0.2, "Hz", "Step of the drive frequency in the coarse search.")
    seek_s: float = _amount(1.5, "s", "Rig time at each frequency of the coarse search.")
    sample_s: float = _amount(0.5, "s", "Rig time between two corrections of the frequency during tracking.")
    time_constant_s: float = _amount(
        3.0, "s", "Time constant of these corrections; it must be longer than the structure takes to respond."
    )
    seek_limit_s: float = _amount(60.0, "s", "Rig time after which the run is aborted if it has not locked yet.")
    lose_limit_s: float = _amount(20.0, "s", "Rig time without a lock, after the first one, that aborts the run.")
    superior_limit_m: float = superior_limit_field()

    def __attrs_post_init__(self) -> None:
        if not self.low_hz < self.start_hz < self.high_hz:
            raise ConfigError(
                f"start_hz (--start) must be > {self.low_hz:g} Hz (low_hz) and < {self.high_hz:g} Hz (high_hz), "
                f"got {self.start_hz:g} Hz"
            )
