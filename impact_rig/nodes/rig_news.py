# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What the rig node tells its log: one line each time something has begun, ended or gone wrong.

It looks at the state a few times a second and speaks of what has changed since, so nothing is said twice and a fault
that flickers does not flood the log.
"""

from __future__ import annotations

from collections.abc import Callable

from impact_rig import topics
from impact_rig.nodes.managed import ManagedNode
from impact_rig.nodes.pacing import AckWindow
from impact_rig.nodes.readers import Readers
from impact_rig.nodes.rig_status import RigStatus
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig

MOST = 5
"""Faults that are told of at one look; of more only the number."""


class RigNews:
    """Watches a rig for its log.

    Args:
        node: whose log it is.
    """

    def __init__(self, node: ManagedNode[RigConfig]) -> None:
        self._node = node
        self._latched: str | None = None
        self._faults: dict[int, str] = {}
        self._silent: tuple[str, ...] = ()
        self._gone: set[str] = set()

    def begun(self, config: RigConfig, absent: str) -> None:
        """Say what runs from scan 0 on.

        Args:
            config: in force.
            absent: peers that did not come in time, with commas between.
        """
        self._latched, self._faults, self._silent = None, {}, ()
        self._info(f"running: {summary(config)}")
        if absent:
            self._warn(f"scan 0 without {absent}, which did not come in time")

    def look(self, rig: Rig, figures: RigStatus, window: AckWindow, readers: Readers) -> None:
        """Say what has changed since the last look."""
        if rig.latched != self._latched:
            self._latched = rig.latched
            if self._latched is None:
                self._info("latch released: the shaker takes commands again")
            else:
                self._warn(f"tripped: shaker latched by {self._latched}, ~/clear_trip releases it")
        self._look_at_faults(figures.faults)
        silent = window.silent()
        for name in set(silent).difference(self._silent):
            self._warn(f"peer {name} is silent: it owes acknowledgements of {topics.SCAN.name}")
        for name in set(self._silent).difference(silent):
            self._info(f"peer {name} is back")
        self._silent = silent
        for name in readers.gone(window.heard()):
            window.forget(name)
            self._gone.add(name)
            self._warn(f"{name} no longer subscribes to {topics.SCAN.name}")
        for name in [name for name in self._gone if name in window.heard()]:
            self._gone.remove(name)
            self._info(f"{name} subscribes to {topics.SCAN.name} again")

    def _look_at_faults(self, now: dict[int, str]) -> None:
        before, self._faults = self._faults, dict(now)
        self._few([f"fault {number} acts: {now[number]}" for number in now.keys() - before.keys()], self._warn)
        self._few([f"fault {number} is over: {before[number]}" for number in before.keys() - now.keys()], self._info)

    def _few(self, lines: list[str], say: Callable[[str], None]) -> None:
        for line in sorted(lines)[:MOST]:
            say(line)
        if len(lines) > MOST:
            say(f"and {len(lines) - MOST} more faults")

    def _info(self, text: str) -> None:
        self._node.get_logger().info(text)

    def _warn(self, text: str) -> None:
        self._node.get_logger().warning(text)


def summary(config: RigConfig) -> str:
    """Return in one line what decides a run: mode, rate, gap, law, seed."""
    factor = f" x {config.time.factor:g}" if config.time.mode == "realtime" else ""
    gap = f"gap {1e3 * config.barriers.gap_m:g} mm, law {config.contact.law}"
    sphere = gap if config.sphere.present else "no sphere"
    return f"{config.time.mode}{factor}, {config.daq.rate_hz} scans/s, {sphere}, seed {config.daq.seed}"
