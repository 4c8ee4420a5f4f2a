# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a rig says of itself: its word, its sentence and figures for diagnostics, and lines for its log.

The log gets one line each time something has begun, ended or gone wrong: it is looked for a few times a second, so
nothing is said twice and a fault that flickers does not flood the log.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from impact_rig import states, topics
from impact_rig.nodes.diagnostics import Health, Level, State, worst
from impact_rig.nodes.inputs import Inputs
from impact_rig.physics.stream import State as StreamState
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig
from impact_rig.simtime import NS_PER_S

SLOW_S = 1.0
"""A reader this much wall time behind is reported; with 100 blocks per second its queue holds ten times that."""
CLOCK_STEP_S = 0.1
"""A step of the system clock by this much is reported; slewing moves both clocks alike."""
_WITHOUT = {"ramp": "is ramped to zero", "hold": "holds the last one", "trip": "is ramped to zero"}
MOST = 5
"""Faults that are told of at one look; of more only the number."""


class RigState:
    """Looks at a rig and puts into words what it sees.

    Args:
        inputs: of the rig.
    """

    def __init__(self, inputs: Inputs) -> None:
        self._session, self._steps = inputs.session, inputs.steps
        self._node = inputs.session.node
        self._latched: str | None = None
        self._faults: dict[int, str] = {}
        self._stream: StreamState | None = None
        self._silent: tuple[str, ...] = ()
        self._gone: set[str] = set()

    def begun(self, absent: str) -> None:
        """Tell the log what runs from scan 0 on.

        Args:
            absent: peers that did not come in time, with commas between.
        """
        self._latched, self._faults, self._silent = None, {}, ()
        self._info(f"running: {summary(self._node.settings)}")
        if absent:
            self._warn(f"scan 0 without {absent}, which did not come in time")

    def word(self) -> State:
        """Return what the rig does: what keeps it from beginning or from going on, what holds the shaker, its drive."""
        session, words = self._session, states.Rig
        obstacle = session.gate.obstacle() if session.gate is not None else None
        if obstacle is not None:
            return obstacle
        rig, timing = session.rig, self._node.settings.time
        if rig is None or session.readers is None or session.duplicates is None:  # between two callbacks only
            return State(words.INACTIVE, self._node.state)
        others = session.duplicates.sentence()
        missing = () if session.readers.all_matched() else session.readers.missing()
        silent = () if session.is_realtime else session.window.silent()
        if others:
            return State(words.RIVAL, others)
        if missing and not session.is_realtime:
            return State(words.NO_PEER, f"waiting for peer {', '.join(missing)}")
        if silent:
            return State(words.SILENT_PEER, f"peer {', '.join(silent)} silent for {timing.peer_timeout_s:g} s")
        if session.starving():
            return State(words.SILENT_PEER, f"{session.controllers()} sends no samples on {topics.WAVEFORM.name}")
        if rig.latched is not None:
            return State(words.TRIPPED, rig.latched)
        if session.paused:
            return State(words.PAUSED, "~/pause")
        if timing.mode == "stepped" and self._steps.is_idle:
            return State(words.PAUSED, "no step is asked for")
        if rig.plucked:
            return State(words.PLUCKED)
        without = f"without peer {', '.join(missing)}" if missing else ""
        return State(words.DRIVING if rig.amplitude or rig.streaming else words.AT_REST, without)

    def health(self) -> Health:
        """Return mode, time, lateness, peers, shaker, over-ranges; or why the rig has not begun."""
        session, config = self._session, self._node.settings
        obstacle = session.gate.obstacle() if session.gate is not None else None
        if obstacle is not None:
            level = Level.ERROR if obstacle.word is states.Rig.RIVAL else Level.WARN
            return Health(level, obstacle.reason, {"mode": config.time.mode})
        rig, readers, duplicates = session.rig, session.readers, session.duplicates
        if rig is None or readers is None or duplicates is None:
            return Health(Level.WARN, self._node.state, {"mode": config.time.mode})
        pacer, window, counts = session.pacer, session.window, session.counts
        clock_step_s = (time.time_ns() - time.monotonic_ns() - session.clock_offset_ns) / NS_PER_S
        realtime = config.time.mode == "realtime"
        silent = () if realtime else window.silent()
        missing = () if readers.all_matched() else readers.missing()
        others = duplicates.sentence()
        behind = window.behind()
        troubles = [(Level.OK, f"running, {config.time.mode}")]
        if session.paused:
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
        if session.starving():
            who = session.controllers()
            troubles.append((Level.ERROR, f"paused: {who} sends no samples (~/pause false goes on without)"))
        if rig.latched is not None:
            troubles.append((Level.ERROR, f"shaker latched by {rig.latched}"))
        if rig.takes_samples:
            troubles += self._stream_troubles(rig)
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
        if counts.faults:
            troubles.append((Level.OK, f"faults active: {', '.join(counts.faults.values())}"))
        level, message = worst(*troubles)
        energy = rig.simulation.energy()
        lost_j = energy.columns + energy.shaker + energy.contact + energy.friction
        largest = max(abs(energy.work), abs(lost_j), abs(energy.stored))
        values: dict[str, object] = {
            "mode": config.time.mode,
            "factor": pacer.factor,
            "rig_time_s": (rig.next_block_ns - rig.start_ns) / NS_PER_S,
            "blocks": counts.blocks,
            "block_rate_hz": counts.block_rate_hz(),
            "lost_blocks": counts.lost_blocks,
            "frequency_hz": rig.frequency_hz,
            "current_a": rig.amplitude,
            "latched": rig.latched or "",
            "impacts": counts.impacts,
            "restitution": config.contact.restitution,
            "realised_restitution": session.realised_restitution,
            "energy_work_j": energy.work,
            "energy_lost_j": lost_j,
            "energy_stored_j": energy.stored,
            "energy_imbalance": abs(energy.imbalance) / largest if largest else 0.0,
            "active_faults": len(counts.faults),
            "faults": ", ".join(counts.faults.values()),
            "slips": pacer.slips,
            "slipped_s": pacer.slipped_ns / NS_PER_S,
            "clock_step_s": clock_step_s,
            "other_publishers": others,
            "subscribers": readers.subscribers,
            "other_acks": counts.other_acks,
        }
        if rig.takes_samples:
            row = rig.stream_state().rows[0]
            values |= {f"stream.{name}": row[name] for name in row.dtype.names[1:]}
        late = pacer.lateness() if realtime else None
        if late is not None:
            values |= {
                "lateness_median_ms": late.median_ms,
                "lateness_p99_ms": late.p99_ms,
                "lateness_worst_ms": late.worst_ms,
            }
        values |= {f"behind.{name}": count for name, count in behind.items()}
        values |= {f"over_range.{one.name}": counts.over_range[one.name] for one in config.instruments.fitted()}
        return Health(level, message, values)

    def _stream_troubles(self, rig: Rig) -> list[tuple[Level, str]]:
        found, who = [], self._session.controllers()
        if " and " in who:
            found.append((Level.WARN, f"{who} all send samples: the last to come counts"))
        if rig.stream.state is StreamState.MISSING:
            found.append(
                (Level.WARN, f"no samples of {who} in time: the drive {_WITHOUT[rig.config.drive.on_underrun]}")
            )
        return found

    # The log

    def look(self) -> None:
        """Tell the log what has changed since the last look."""
        session = self._session
        rig, readers, window = session.rig, session.readers, session.window
        if rig is None or readers is None:
            return
        if rig.latched != self._latched:
            self._latched = rig.latched
            if self._latched is None:
                self._info("latch released: the shaker takes commands again")
            else:
                self._warn(f"tripped: shaker latched by {self._latched}, ~/clear_trip releases it")
        self._look_at_faults(session.counts.faults)
        state = rig.stream.state if rig.takes_samples else None
        if state is not self._stream and StreamState.MISSING in (state, self._stream):
            say = self._warn if state is StreamState.MISSING else self._info
            say(f"{topics.WAVEFORM.name}: {state.value if state else 'the drive is another one'}")
        self._stream = state
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
