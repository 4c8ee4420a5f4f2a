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
"""Status of a rig: its state, message and values in diagnostics, and the lines of its log.

The log gets one line each time something starts, ends or goes wrong. Ten times a second, the status is compared with
the last one, so nothing is logged twice.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import attrs

from impact_rig import states, topics
from impact_rig.names import one_line
from impact_rig.nodes.managed import Level, NodeState, worst
from impact_rig.nodes.session import Session
from impact_rig.physics.stream import StreamState
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig
from impact_rig.simtime import NS_PER_S

SLOW_S = 1.0
"""Lag [s of wall time] beyond which diagnostics report that a reader is behind.

At 100 blocks per second, the queue of a reader holds the blocks of ten seconds.
"""
CLOCK_STEP_S = 0.1  # steps of the system clock of this size are reported; slewing changes both clocks alike
_WITHOUT = {"ramp": "the drive ramps to zero", "hold": "the last one is held", "trip": "the drive ramps to zero"}
"""Behaviour of the shaker while samples of its drive are missing, by `drive.on_underrun`."""
MOST = 5  # maximum number of started, and of ended faults logged in one update; of the others, only the number is


@attrs.frozen
class Problem:
    """Problem of a rig for diagnostics: its level, its message, and the state of the rig that it causes, if any."""

    level: Level
    message: str
    state: NodeState | None = None


class RigState:
    """Description of a rig for diagnostics and the log, derived from its session."""

    def __init__(self, session: Session) -> None:
        self._session, self._node = session, session.node
        self._rig: Rig | None = None
        self._latched: str | None = None
        self._faults: dict[int, str] = {}
        self._stream: StreamState | None = None
        self._silent: tuple[str, ...] = ()
        self._gone: set[str] = set()
        self._lost: dict[str, int] = {}  # by subscriber, the largest number of blocks beyond what is kept for it

    def word(self) -> NodeState:
        """Return the state of the rig, with its reason: the most severe `states.RigWord` that applies now.

        If no problem causes a state, it is DRIVING or AT_REST.
        """
        session = self._session
        reason_not_ready = session.reason_not_ready()
        if reason_not_ready is not None:
            return reason_not_ready
        if session.rig is None:  # only between two callbacks
            return NodeState(states.RigWord.INACTIVE, self._node.state)
        found = next((one.state for one in self._problems(session.rig) if one.state is not None), None)
        if found is not None:
            return found
        missing = () if session.readers.all_matched() else session.readers.missing()
        without = f"without peer {', '.join(missing)}" if missing else ""
        return NodeState(states.RigWord.DRIVING if session.rig.is_driven else states.RigWord.AT_REST, without)

    def health(self) -> tuple[Level, str]:
        """Return level and message for diagnostics.

        The message lists the problems of the most severe level, or the reason why no rig has started. Without a warning
        or error the level is OK, and the message begins with `running in time mode`.
        """
        reason_not_ready, rig = self._session.reason_not_ready(), self._session.rig
        if reason_not_ready is not None:
            return Level.ERROR if reason_not_ready.word is states.RigWord.RIVAL else Level.WARN, reason_not_ready.reason
        if rig is None:
            return Level.WARN, self._node.state
        running = (Level.OK, f"running in time mode {self._node.settings.time.mode}")
        return worst(running, *((one.level, one.message) for one in self._problems(rig)))

    def figures(self) -> dict[str, object]:
        """Return values for diagnostics: time mode and, once started, time, lateness, readers, drive, energy, scans.

        Which keys there are depends on the time mode, the drive, the channels and the readers.
        """
        session, config = self._session, self._node.settings
        rig = session.rig
        if rig is None:
            return {"mode": config.time.mode}
        pacer, counts = session.pacer, session.counts
        energy = rig.simulation.energy()
        lost_j = energy.columns + energy.shaker + energy.contact + energy.friction
        largest = max(abs(energy.work), abs(lost_j), abs(energy.stored))
        values: dict[str, object] = {
            "mode": config.time.mode,
            "factor": pacer.factor,
            "start_ns": rig.start_ns,
            "rig_time_s": (rig.next_block_ns - rig.start_ns) / NS_PER_S,
            "blocks": counts.blocks,
            "block_rate_hz": counts.block_rate_hz(),
            "lost_blocks": counts.lost_blocks,
            "frequency_hz": rig.frequency_hz,
            "current_a": rig.target_amplitude,
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
            "clock_step_s": self._clock_step_s(),
            "other_publishers": session.duplicates.sentence(),
            "subscribers": session.readers.subscribers,
            "other_acks": counts.other_acks,
        }
        if rig.takes_samples:
            row = rig.stream_state().rows[0]
            values |= {f"stream.{name}": row[name] for name in row.dtype.names[1:]}
        late = pacer.lateness() if session.is_realtime else None
        if late is not None:
            values |= {
                "lateness_median_ms": late.median_ms,
                "lateness_p99_ms": late.p99_ms,
                "lateness_worst_ms": late.worst_ms,
            }
        values |= {f"behind.{name}": count for name, count in session.window.behind().items()}
        values |= {f"lost.{name}": count for name, count in self._lost.items()}
        over_range = counts.over_range()
        values |= {f"over_range.{one.name}": over_range[one.name] for one in config.instruments.fitted()}
        return values

    def _clock_step_s(self) -> float:
        return (time.time_ns() - time.monotonic_ns() - self._session.clock_offset_ns) / NS_PER_S

    def _problems(self, rig: Rig) -> Iterator[Problem]:
        """Yield the problems of a started rig.

        Problems that cause a state are in the order of `states.RigWord`, the most severe first. Other problems may be
        anywhere between them.
        """
        session, words, readers = self._session, states.RigWord, self._session.readers
        timing, daq, realtime = self._node.settings.time, self._node.settings.daq, session.is_realtime
        others = session.duplicates.sentence()
        missing = "" if readers.all_matched() else ", ".join(readers.missing())
        silent = "" if realtime else ", ".join(session.window.silent())
        if others:
            yield Problem(Level.ERROR, f"{others}; end one of them", NodeState(words.RIVAL, others))
        if missing and not realtime:
            waiting = f"waiting for peer {missing} to subscribe to {topics.SCAN.name}"
            level = Level.ERROR if readers.overdue(timing.peer_timeout_s) else Level.WARN
            yield Problem(level, waiting, NodeState(words.NO_PEER, waiting))
        patience = f"for {timing.peer_timeout_s:g} s"
        quiet = [f"peer {silent} silent, no block of {topics.SCAN.name} acknowledged {patience}"] if silent else []
        if session.is_starving:
            quiet.append(session.lack_of_samples())
        for why in quiet:
            go_on = f"rig time stands still: {why} (call ~/pause with false to continue without it)"
            yield Problem(Level.ERROR, go_on, NodeState(words.SILENT_PEER, why))
        if rig.latched is not None:
            latched = f"shaker latched by {rig.latched}: it stays stopped until ~/clear_trip"
            yield Problem(Level.ERROR, latched, NodeState(words.TRIPPED, rig.latched))
        if session.paused:
            paused = "paused: rig time stands still until ~/pause is called with false"
            yield Problem(Level.WARN, paused, NodeState(words.PAUSED, "~/pause"))
        if session.is_lockstep and session.is_idle:
            yield Problem(Level.OK, "", NodeState(words.PAUSED, "no step is requested"))
        without = missing if realtime else ", ".join(session.window.waived())
        if without:
            yield Problem(Level.WARN, f"running without peer {without}, which does not read {topics.SCAN.name}")
        if rig.takes_samples:
            who = session.controllers()
            if len(who) > 1:
                several = f"{' and '.join(who)} all send samples of the drive on {topics.WAVEFORM.name}"
                yield Problem(Level.WARN, f"{several}: the last one received for a time counts; end all but one")
            if rig.stream.state is StreamState.MISSING:
                whose = f"samples of {' and '.join(who)}" if who else "samples of the drive, which no node publishes,"
                yield Problem(Level.WARN, f"{whose} did not arrive in time: {_WITHOUT[rig.config.drive.on_underrun]}")
        if session.pacer.slips:
            lag_s = session.pacer.slipped_ns / NS_PER_S
            slow = f"the rig could not keep real time and gave up a lag of {lag_s:.1f} s: it needs more processor time"
            yield Problem(Level.WARN, slow)
        if realtime:
            per_second = daq.rate_hz * timing.factor / daq.block_scans
            for name, count in session.window.behind().items():
                if count > SLOW_S * per_second + 1:
                    loses = " and loses scans" if count > session.publishers.kept_blocks else ""
                    late = f"{name} is {count / per_second:.0f} s behind in reading {topics.SCAN.name}{loses}"
                    yield Problem(Level.WARN, late)
        if realtime and abs(self._clock_step_s()) > CLOCK_STEP_S:
            moved = f"the system clock was set by {self._clock_step_s():+.3f} s; the rig's stamps ignore this"
            yield Problem(Level.WARN, moved)
        if rig.plucked:
            yield Problem(Level.OK, "base locked after a pluck until ~/reset", NodeState(words.PLUCKED))
        if session.counts.faults:
            yield Problem(Level.OK, f"instrument faults active: {', '.join(session.counts.faults.values())}")

    # The log

    def log_changes(self) -> None:
        """Log what has changed since the last call: start, trips, faults, samples of the drive, and the readers' state.

        The method also updates the flow control. A silent peer that was restarted need not acknowledge the blocks
        published so far. The acknowledgements of a reader that no longer subscribes are dropped. If that reader is a
        peer, the rig continues to wait for it, except in real time.
        """
        session = self._session
        rig, window = session.rig, session.window
        if rig is None:
            return
        if rig is not self._rig:
            self._rig, self._latched, self._faults, self._silent, self._lost = rig, None, {}, (), {}
            self._info(f"running: {summary(self._node.settings)}")
            if session.absent:
                self._warn(
                    f"started without peer {session.absent}, which did not subscribe to {topics.SCAN.name} in time"
                )
        if rig.latched != self._latched:
            self._latched = rig.latched
            if self._latched is None:
                self._info("latch released: the shaker accepts commands again")
            else:
                self._warn(f"tripped: shaker latched by {self._latched}; ~/clear_trip releases it")
        state = rig.stream.state if rig.takes_samples else None
        if state is not self._stream and StreamState.MISSING in (state, self._stream):
            say = self._warn if state is StreamState.MISSING else self._info
            say(f"{topics.WAVEFORM.name}: {state.value if state else 'the drive is not a stream'}")
        self._stream = state
        self._log_faults(session.counts.faults)
        for name, count in window.behind().items():
            lost = count - session.publishers.kept_blocks
            if lost > self._lost.get(name, 0):
                if name not in self._lost:
                    self._warn(f"{name} reads too slowly and loses blocks of {topics.SCAN.name}")
                self._lost[name] = lost
        # A restarted peer never received the outstanding blocks: stop waiting for its predecessor.
        window.forgive(name for name in window.silent() if session.readers.came_ns(name) > window.heard_ns(name))
        silent = window.silent()
        for name in set(silent).difference(self._silent):
            self._warn(f"peer {name} is silent: it does not acknowledge blocks of {topics.SCAN.name}")
        for name in set(self._silent).difference(silent):
            self._info(f"peer {name} acknowledges {topics.SCAN.name} again")
        self._silent = silent
        for name in session.readers.gone(window.heard()):
            window.forget(name)
            self._gone.add(name)
            self._warn(f"{name} no longer subscribes to {topics.SCAN.name}")
        for name in [name for name in self._gone if name in window.heard()]:
            self._gone.remove(name)
            self._info(f"{name} subscribes to {topics.SCAN.name} again")

    def _log_faults(self, now: dict[int, str]) -> None:
        before, self._faults = self._faults, dict(now)
        started, ended = now.keys() - before.keys(), before.keys() - now.keys()
        for numbers, faults, verb, say in ((started, now, "started", self._warn), (ended, before, "ended", self._info)):
            for number in sorted(numbers)[:MOST]:
                say(f"instrument fault {number} has {verb}: {faults[number]}")
            if len(numbers) > MOST:
                say(f"{len(numbers) - MOST} further instrument faults have {verb}")

    def _info(self, text: str) -> None:
        self._node.get_logger().info(one_line(text))

    def _warn(self, text: str) -> None:
        self._node.get_logger().warning(one_line(text))


def summary(config: RigConfig) -> str:
    """Return one line about a rig for its log: time mode, scan rate, gap and contact law (or `no sphere`), and seed."""
    factor = f" x {config.time.factor:g}" if config.time.mode == "realtime" else ""
    gap = f"gap {1e3 * config.barriers.gap_m:g} mm, contact law {config.contact.law}"
    sphere = gap if config.sphere.present else "no sphere"
    return f"{config.time.mode}{factor}, {config.daq.rate_hz} scans/s, {sphere}, seed {config.daq.seed}"
