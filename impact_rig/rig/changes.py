# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a change of a configuration value touches, and from when on; what becomes of planned faults that change."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator

import attrs

from impact_rig.errors import ConfigError
from impact_rig.instruments.fault import Fault
from impact_rig.instruments.section import Setup
from impact_rig.rig.config import RigConfig, to_flat
from impact_rig.rig.journal import NOT_SAMPLED, SAMPLED, Value

MECHANICS = ("structure.", "shaker.", "sphere.", "barriers.", "contact.")
INSTRUMENTS = ("instruments.", "daq.")
PLANNED = "instruments.faults.planned"
AT_RESET = ("drive.", "daq.seed")
"""What is drawn or commanded at the beginning only."""


def takes_effect(name: str) -> str:
    """Return from when on a new value of a parameter acts on a running rig, in words."""
    if name == PLANNED:
        return "next command instant, for the lines that are new or gone"
    if name.startswith(AT_RESET):
        return "next reset"
    if name.startswith(NOT_SAMPLED) and name not in SAMPLED:
        return "at once"
    if name.startswith(("sphere.", "barriers.", "contact.")):
        return "next command instant; the sphere rests at `sphere.start` again"
    return "next command instant"


def changed_values(before: RigConfig, after: RigConfig) -> dict[str, Value]:
    """Return the values of `after` that `before` has otherwise, by name.

    Raises:
        ConfigError: one is fixed at start.
    """
    if (after.daq.rate_hz, after.daq.block_scans) != (before.daq.rate_hz, before.daq.block_scans):
        raise ConfigError("daq.rate_hz and daq.block_scans are fixed at start")
    old = to_flat(before)
    return {name: value for name, value in to_flat(after).items() if value != old[name]}


def until_reset(present: Setup, config: RigConfig) -> RigConfig:
    """Return `config` with the seed and the planned faults of `present`: the instruments draw both at a reset."""
    return attrs.evolve(
        config,
        daq=attrs.evolve(config.daq, seed=present.daq.seed),
        instruments=attrs.evolve(config.instruments, faults=present.instruments.faults),
    )


@attrs.frozen
class Replan:
    """What one change of the list does: the lines that go, and the lines that come with the faults they make."""

    gone: tuple[str, ...]
    new: tuple[tuple[str, Fault], ...]


class PlanInForce:
    """Which line made which faults.

    Args:
        lines: `instruments.faults.planned` at the beginning; the fault board has numbered their faults from 1.
        rate_hz: scan rate.
    """

    def __init__(self, lines: Iterable[str], rate_hz: int) -> None:
        self._rate_hz = rate_hz
        self._numbers: defaultdict[str, list[int]] = defaultdict(list)
        for number, line in enumerate(_written(lines), start=1):
            self._numbers[line].append(number)

    def replan(self, lines: Iterable[str]) -> Replan:
        """Return what turns the present lines into these; nothing changes before `put_into_force`.

        Raises:
            ConfigError: an added line describes no fault.
        """
        before = Counter({line: len(numbers) for line, numbers in self._numbers.items()})
        after = Counter(_written(lines))
        new = tuple((line, Fault.from_line(line, self._rate_hz)) for line in (after - before).elements())
        return Replan(tuple((before - after).elements()), new)

    def put_into_force(
        self, replan: Replan, sample: int, clear: Callable[[int], None], inject: Callable[[Fault], int]
    ) -> None:
        """Clear the faults of the lines that go, then inject those of the lines that come.

        Args:
            replan: as `replan` returned it, with no other change in between.
            sample: the first scan it acts on; the `start_s` of new lines count from there.
            clear: ends the fault of a number, which may have ended already.
            inject: starts a fault and returns its number.
        """
        for line in replan.gone:
            clear(self._numbers[line].pop())
        for line, fault in replan.new:
            number = inject(attrs.evolve(fault, start_sample=sample + fault.start_sample))
            self._numbers[line].append(number)


def _written(lines: Iterable[str]) -> Iterator[str]:
    """Yield the lines that say something, as `FaultPlan.faults` reads them."""
    return (line for line in lines if line.split())
