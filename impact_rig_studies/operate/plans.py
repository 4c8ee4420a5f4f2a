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
"""Plans of the operators: the points, the controlled amplitude and the tracked resonance, with their limits."""

from __future__ import annotations

import enum
from typing import Any

import attrs

from impact_rig.config.fields import Origin, choice, integer, quantities, quantity, switch
from impact_rig.errors import ConfigError


class Direction(enum.StrEnum):
    """Order of the points; up_down keeps the state of the rig between the two."""

    UP = "up"
    DOWN = "down"
    UP_DOWN = "up_down"


def current_field() -> Any:
    """Return the field of the current that a sweep or a search sets."""
    return quantity(0.52, "A", "Peak current (m or V by drive.kind).", Origin.IDENTIFIED, above=0, at_most=1000)


def superior_limit_field() -> Any:
    """Return the field of the largest motion of the superior base that a controller accepts."""
    return quantity(0.05, "m", "Amplitude of the superior base above which a controller aborts.", above=0, at_most=1)


@attrs.frozen(kw_only=True)
class SweepPlan:
    """Points and limits of a stepped sweep; its fields are also parameters of the stepped-sine node.

    Raises:
        ConfigError: an invalid value; the message names it.
    """

    frequencies_hz: tuple[float, ...] = quantities(
        (7.5, 8.0, 8.5, 8.9, 9.0, 9.1, 9.2, 9.5, 10.0, 10.5),
        "Hz",
        "Frequencies of the points.",
        Origin.PAPER,
        above=0,
        at_most=10_000,
    )
    current_a: float = current_field()
    direction: str = choice("up", tuple(Direction), "Order of the points; up_down keeps the state between the two.")
    measurements_per_point: int = integer(1, "-", "Number of measurements at each point.", at_least=1, at_most=1000)
    dwell_limit_s: float = quantity(
        150.0, "s", "Rig time at one point after which the sweep is aborted.", above=0, at_most=1e9
    )
    accept_limit_s: float = quantity(
        5.0, "s", "Rig time within which a command must be accepted.", above=0, at_most=1e5
    )
    retries: int = integer(2, "-", "Number of rejected measurements tolerated per point.", at_least=0, at_most=1000)
    skip_over_range: bool = switch(True, "Skip a point where a sensor is over range, instead of aborting.")
    keep_unsettled: bool = switch(True, "Accept a response that does not settle within the analysis' limit.")

    def __attrs_post_init__(self) -> None:
        if len(set(self.frequencies_hz)) != len(self.frequencies_hz):
            raise ConfigError(f"frequencies_hz must not repeat a frequency, got {self.frequencies_hz!r}")

    def points(self) -> tuple[float, ...]:
        """Return the frequencies in the order of measurement."""
        up = tuple(sorted(self.frequencies_hz))
        down = up[::-1]
        return {Direction.UP: up, Direction.DOWN: down, Direction.UP_DOWN: up + down}[Direction(self.direction)]


class Hold(enum.StrEnum):
    """Held quantity."""

    CURRENT = "current"
    BASE = "base"
    SUPERIOR = "superior"


@attrs.frozen(kw_only=True, slots=False)  # one of several bases of the node's parameters
class HoldPlan:
    """Controlled amplitude, and limits of its control; its fields are also parameters of the stepped-sine node.

    Raises:
        ConfigError: an invalid value; the message names it.
    """

    hold: str = choice("base", tuple(Hold), "Controlled amplitude.")
    target: float = quantity(
        60e-6, "m or A", "Held amplitude, peak; ignored if hold is command or phase.", above=0, at_most=1000
    )
    tolerance: float = quantity(
        2e-3, "-", "Relative error up to which the amplitude counts as held.", above=0, at_most=0.5
    )
    corrections: int = integer(
        8, "-", "Maximum number of adjustments of the current per point.", at_least=1, at_most=1000
    )
    current_limit_a: float = quantity(
        15.0, "A", "Current above which a held amplitude aborts the sweep.", above=0, at_most=1000
    )
    superior_limit_m: float = superior_limit_field()


class Reference(enum.StrEnum):
    """Reference of the superior base's phase."""

    BASE = "base"
    CURRENT = "current"


def _amount(default: float, unit: str, doc: str) -> Any:
    return quantity(default, unit, doc, above=0)


@attrs.frozen(kw_only=True, slots=False)  # one of several bases of the node's parameters
class LockSettings:
    """Settings of a phase lock that are also parameters of the stepped-sine node."""

    reference: str = choice("base", tuple(Reference), "Reference of the superior base's phase.")
    within_deg: float = quantity(
        2.0, "deg", "Deviation of a second's mean phase up to which it counts as locked.", above=0, at_most=90
    )
    dwell_s: float = quantity(30.0, "s", "Rig time at the resonance, from the first lock on.", above=0, at_most=1e9)


@attrs.frozen(kw_only=True)
class LockPlan(LockSettings):
    """Plan of the search for a resonance, of its tracking and of the dwell there.

    Raises:
        ConfigError: an invalid value; the message names it.
    """

    start_hz: float = _amount(9.0, "Hz", "Frequency where the search begins.")
    current_a: float = current_field()
    low_hz: float = _amount(5.0, "Hz", "Lowest frequency.")
    high_hz: float = _amount(20.0, "Hz", "Highest frequency.")
    step_hz: float = _amount(0.2, "Hz", "Step of the coarse search.")
    seek_s: float = _amount(1.5, "s", "Rig time at each step of the search.")
    sample_s: float = _amount(0.5, "s", "Rig time between two corrections of the frequency.")
    time_constant_s: float = _amount(
        3.0, "s", "Time constant of the correction; longer than the structure takes to respond."
    )
    seek_limit_s: float = _amount(60.0, "s", "Rig time until the first lock after which the search ends.")
    lose_limit_s: float = _amount(20.0, "s", "Rig time without lock after which the run ends.")
    superior_limit_m: float = superior_limit_field()

    def __attrs_post_init__(self) -> None:
        if not self.low_hz < self.start_hz < self.high_hz:
            raise ConfigError(
                f"start_hz must be within low_hz = {self.low_hz:g} and high_hz = {self.high_hz:g}, "
                f"got {self.start_hz:g}"
            )
