"""The rig's diagnostics: one sentence and the figures behind it."""

from __future__ import annotations

import math
from collections import Counter

from impact_rig.blocks import CHANNELS
from impact_rig.config import RigConfig
from impact_rig.nodes.diagnostics import Level, Status, worst
from impact_rig.pacing import AckWindow, Pacer
from impact_rig.rig import Block, Rig
from impact_rig.simtime import NS_PER_S


class RigStatus:
    """Counts what goes out, and puts the status together."""

    def __init__(self) -> None:
        self.blocks = 0
        self.lost_blocks = 0
        self.impacts = 0
        self.over_range: Counter[str] = Counter()
        self.faults: set[int] = set()
        self.realised_restitution = math.nan
        """What the contact law really returns: with the paper's law 0.309 for 0.35."""

    def count(self, block: Block) -> None:
        """Count one published block."""
        self.blocks += 1
        self.lost_blocks += block.lost
        if block.impacts is not None:
            self.impacts += len(block.impacts.rows)
        status = block.scan.rows["status"]
        if status.any():
            for bit, name in enumerate(CHANNELS):
                self.over_range[name] += int(((status >> bit) & 1).sum())
        if block.faults is not None:
            for row in block.faults.rows:
                (self.faults.add if row["active"] else self.faults.discard)(int(row["id"]))

    def status(
        self,
        state: str,
        rig: Rig | None,
        config: RigConfig,
        pacer: Pacer,
        window: AckWindow,
        missing: tuple[str, ...],
        paused: bool,
    ) -> Status:
        """Return the node's status."""
        if rig is None:
            return Status(Level.WARN, state, {"mode": config.time.mode})
        silent = window.silent()
        troubles = [(Level.OK, f"running, {config.time.mode}")]
        if paused:
            troubles.append((Level.WARN, "paused"))
        if missing:
            troubles.append((Level.WARN, f"waiting for peer {', '.join(missing)}"))
        if silent:
            seconds = f"{config.time.peer_timeout_s:g} s"
            names = ", ".join(silent)
            troubles.append((Level.ERROR, f"paused: peer {names} silent for {seconds} (~/pause false goes on without)"))
        if rig.latched is not None:
            troubles.append((Level.ERROR, f"shaker latched by {rig.latched}"))
        if pacer.slips:
            troubles.append((Level.WARN, "could not keep real time: see slips"))
        if rig.plucked:
            troubles.append((Level.OK, "base locked after a pluck"))
        level, message = worst(*troubles)
        values: dict[str, object] = {
            "mode": config.time.mode,
            "factor": pacer.factor,
            "rig_time_s": (rig.next_block_ns - rig.start_ns) / NS_PER_S,
            "blocks": self.blocks,
            "lost_blocks": self.lost_blocks,
            "frequency_hz": rig.frequency_hz,
            "current_a": rig.amplitude,
            "impacts": self.impacts,
            "restitution": config.contact.restitution,
            "realised_restitution": self.realised_restitution,
            "active_faults": len(self.faults),
            "slips": pacer.slips,
            "slipped_s": pacer.slipped_ns / NS_PER_S,
        }
        late = pacer.lateness() if config.time.mode == "realtime" else None
        if late is not None:
            values |= {
                "lateness_median_ms": late.median_ms,
                "lateness_p99_ms": late.p99_ms,
                "lateness_worst_ms": late.worst_ms,
            }
        values |= {f"behind.{name}": count for name, count in window.behind().items()}
        values |= {f"over_range.{name}": count for name, count in self.over_range.items() if count}
        return Status(level, message, values)
