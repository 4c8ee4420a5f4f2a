# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`Plan`: the points of a stepped sweep, and its bounds."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable

import attrs

from impact_rig.errors import ConfigError


class Direction(enum.StrEnum):
    """Order in which the frequencies are visited; up_down keeps the state of the rig between the two."""

    UP = "up"
    DOWN = "down"
    UP_DOWN = "up_down"


@attrs.frozen
class Setpoint:
    """What to set the drive to: frequency [Hz] and peak current [A]."""

    frequency_hz: float
    current_a: float


def positive(_: object, attribute: attrs.Attribute[float], value: float) -> None:
    """Refuse a value of a plan that is not > 0 and finite."""
    if not (math.isfinite(value) and value > 0.0):
        raise ConfigError(f"{attribute.name} must be > 0 and finite, got {value!r}")


def _frequencies(_: object, attribute: attrs.Attribute[tuple[float, ...]], value: tuple[float, ...]) -> None:
    if not value or not all(math.isfinite(one) and one > 0.0 for one in value):
        raise ConfigError(f"{attribute.name} must be one or more finite numbers > 0, got {value!r}")
    if len(set(value)) != len(value):
        raise ConfigError(f"{attribute.name} must not repeat a frequency, got {value!r}")


def _at_least(lowest: int) -> Callable[[object, attrs.Attribute[int], int], None]:
    def check(_: object, attribute: attrs.Attribute[int], value: int) -> None:
        if value < lowest:
            raise ConfigError(f"{attribute.name} must be >= {lowest}, got {value!r}")

    return check


@attrs.frozen(kw_only=True)
class Plan:
    """A stepped sweep.

    Attributes:
        frequencies_hz: the points; visited in ascending or descending order, whatever their order here.
        current_a: peak current at all of them.
        direction: order of the visit.
        measurements_per_point: rows taken at each point.
        dwell_limit_s: rig time at one point after which the sweep is aborted; longer than the tracker's own bound.
        accept_limit_s: rig time within which a command must be accepted.
        retries: refused measurements (lost blocks, silence, …) borne per point.
        skip_over_range: leave out a point where a sensor goes over range, instead of aborting.
        keep_unsettled: take a row of a point whose response did not settle in the tracker's bound (its `settled` is 0).

    Raises:
        ConfigError: a value that cannot work; the message names it.
    """

    frequencies_hz: tuple[float, ...] = attrs.field(converter=tuple, validator=_frequencies)
    current_a: float = attrs.field(validator=positive)
    direction: Direction = attrs.field(default=Direction.UP, converter=Direction)
    measurements_per_point: int = attrs.field(default=1, validator=_at_least(1))
    dwell_limit_s: float = attrs.field(default=150.0, validator=positive)
    accept_limit_s: float = attrs.field(default=5.0, validator=positive)
    retries: int = attrs.field(default=2, validator=_at_least(0))
    skip_over_range: bool = True
    keep_unsettled: bool = True

    def points(self) -> tuple[float, ...]:
        """Return the frequencies in the order of the visit."""
        up = tuple(sorted(self.frequencies_hz))
        down = up[::-1]
        return {Direction.UP: up, Direction.DOWN: down, Direction.UP_DOWN: up + down}[self.direction]
