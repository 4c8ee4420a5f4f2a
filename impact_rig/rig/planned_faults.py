# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Planned faults of a running rig: a line added to the list starts a fault, one taken away ends the fault it made."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator

import attrs

from impact_rig.instruments.fault import Fault


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
