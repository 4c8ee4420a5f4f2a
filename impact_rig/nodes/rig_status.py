# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The rig's diagnostics: one sentence and the figures behind it, named in `figures.RIG`."""

from __future__ import annotations

import math
import time
from collections import Counter, deque

from impact_rig.instruments.scan import channels_of
from impact_rig.nodes.beginning import Rivals
from impact_rig.nodes.diagnostics import Health, Level, worst
from impact_rig.nodes.pacing import AckWindow, Pacer
from impact_rig.nodes.readers import Readers
from impact_rig.rig import Block, Rig
from impact_rig.rig.config import RigConfig
from impact_rig.simtime import NS_PER_S

RATE_WINDOW_S = 2.0
SLOW_S = 1.0
"""A reader this much wall time behind is reported; with 100 blocks per second its queue holds ten times that."""

CLOCK_STEP_S = 0.1
"""A step of the system clock by this much is reported; slewing moves both clocks alike."""


class RigStatus:
    """Counts what goes out, and puts the status together."""

    def __init__(self) -> None:
        self.blocks = 0
        self.lost_blocks = 0
        self.impacts = 0
        self.other_acks = 0
        self.over_range: Counter[str] = Counter()
        self.faults: dict[int, str] = {}
        self.realised_restitution = math.nan
        """What the contact law really returns: with the paper's law 0.309 for 0.35."""
        self._counts: deque[tuple[float, int]] = deque([(time.monotonic(), 0)])

    def count(self, block: Block) -> None:
        """Count one published block."""
        self.blocks += 1
        self.lost_blocks += block.lost
        if block.impacts is not None:
            self.impacts += len(block.impacts.rows)
        status = block.scan.rows["status"]
        if status.any():
            for bit, name in enumerate(channels_of(block.scan.rows)):
                self.over_range[name] += int(((status >> bit) & 1).sum())
        if block.faults is not None:
            for row in block.faults.rows:
                number = int(row["id"])
                if row["active"]:
                    self.faults[number] = f"{row['kind'].decode()}/{row['channel'].decode()}".rstrip("/")
                else:
                    self.faults.pop(number, None)

    def block_rate_hz(self) -> float:
        """Return blocks per second of wall time over about the last two seconds."""
        now = time.monotonic()
        self._counts.append((now, self.blocks))
        while len(self._counts) > 2 and now - self._counts[1][0] > RATE_WINDOW_S:
            self._counts.popleft()
        then, before = self._counts[0]
        return (self.blocks - before) / (now - then) if now > then else 0.0

    def status(
        self,
        state: str,
        rig: Rig | None,
        config: RigConfig,
        pacer: Pacer,
        window: AckWindow,
        readers: Readers | None,
        rivals: Rivals | None,
        paused: bool,
        clock_step_s: float,
    ) -> Health:
        """Return the node's status.

        Args:
            state: of the lifecycle.
            rig: None while there is none.
            config: in force.
            pacer: of realtime.
            window: how far the readers of daq/scan are.
            readers: of daq/scan in the graph; None while there is no rig.
            rivals: other publishers of its topics; None while there is no rig.
            paused: by ~/pause.
            clock_step_s: what the system clock was moved by since the activation.
        """
        if rig is None or readers is None or rivals is None:
            return Health(Level.WARN, state, {"mode": config.time.mode})
        realtime = config.time.mode == "realtime"
        silent = () if realtime else window.silent()
        missing = () if readers.all_matched() else readers.missing()
        others = rivals.sentence()
        behind = window.behind()
        troubles = [(Level.OK, f"running, {config.time.mode}")]
        if paused:
            troubles.append((Level.WARN, "paused"))
        if others:
            troubles.append((Level.ERROR, others))
        if missing and realtime:
            troubles.append((Level.WARN, f"running without peer {', '.join(missing)}"))
        elif missing:
            level = Level.ERROR if readers.overdue(config.time.peer_timeout_s) else Level.WARN
            troubles.append((level, f"waiting for peer {', '.join(missing)}"))
        if silent:
            seconds = f"{config.time.peer_timeout_s:g} s"
            names = ", ".join(silent)
            troubles.append((Level.ERROR, f"paused: peer {names} silent for {seconds} (~/pause false goes on without)"))
        if rig.latched is not None:
            troubles.append((Level.ERROR, f"shaker latched by {rig.latched}"))
        if pacer.slips:
            troubles.append((Level.WARN, "could not keep real time: see slips"))
        if realtime:
            per_second = config.daq.rate_hz * config.time.factor / config.daq.block_scans
            troubles += [
                (Level.WARN, f"{name} is {count / per_second:.0f} s behind")
                for name, count in behind.items()
                if count > SLOW_S * per_second + 1
            ]
        if realtime and abs(clock_step_s) > CLOCK_STEP_S:
            troubles.append((Level.WARN, f"the system clock was moved by {clock_step_s:+.3f} s, stamps were not"))
        if rig.plucked:
            troubles.append((Level.OK, "base locked after a pluck"))
        if self.faults:
            troubles.append((Level.OK, f"faults active: {', '.join(self.faults.values())}"))
        level, message = worst(*troubles)
        energy = rig.simulation.energy()
        lost_j = energy.columns + energy.shaker + energy.contact + energy.friction
        largest = max(abs(energy.work), abs(lost_j), abs(energy.stored))
        values: dict[str, object] = {
            "mode": config.time.mode,
            "factor": pacer.factor,
            "rig_time_s": (rig.next_block_ns - rig.start_ns) / NS_PER_S,
            "blocks": self.blocks,
            "block_rate_hz": self.block_rate_hz(),
            "lost_blocks": self.lost_blocks,
            "frequency_hz": rig.frequency_hz,
            "current_a": rig.amplitude,
            "latched": rig.latched or "",
            "impacts": self.impacts,
            "restitution": config.contact.restitution,
            "realised_restitution": self.realised_restitution,
            "energy_work_j": energy.work,
            "energy_lost_j": lost_j,
            "energy_stored_j": energy.stored,
            "energy_imbalance": abs(energy.imbalance) / largest if largest else 0.0,
            "active_faults": len(self.faults),
            "faults": ", ".join(self.faults.values()),
            "slips": pacer.slips,
            "slipped_s": pacer.slipped_ns / NS_PER_S,
            "clock_step_s": clock_step_s,
            "other_publishers": others,
            "subscribers": readers.subscribers,
            "other_acks": self.other_acks,
        }
        late = pacer.lateness() if realtime else None
        if late is not None:
            values |= {
                "lateness_median_ms": late.median_ms,
                "lateness_p99_ms": late.p99_ms,
                "lateness_worst_ms": late.worst_ms,
            }
        values |= {f"behind.{name}": count for name, count in behind.items()}
        values |= {f"over_range.{one.name}": self.over_range[one.name] for one in config.instruments.fitted()}
        return Health(level, message, values)
