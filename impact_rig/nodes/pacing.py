# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""When blocks are due: realtime pacing against an injected clock, and the acknowledgement window of the other modes.

Nothing here sleeps or knows ROS: whoever owns the loop asks how many blocks are due and says when they are out.
Deadlines are computed from the start, never accumulated, so pacing does not drift; a process that was suspended is
re-based and says by how much.
"""

from __future__ import annotations

import bisect
from collections.abc import Callable, Iterable

import attrs
import numpy as np

from impact_rig.simtime import NS_PER_S

Clock = Callable[[], int]
"""A monotonic clock [ns], e.g. `time.monotonic_ns`."""

MAX_LAG_NS = NS_PER_S
"""Rig time: further behind than this, catching up would overrun every subscriber's queue; realtime is re-based."""
KEPT = 4096
"""Blocks whose stamps are remembered, at least."""
LATENESS_WINDOW = 3000
"""Blocks the lateness statistics look back: 30 s of 10 ms blocks."""


@attrs.frozen
class Lateness:
    """How late the last blocks were published after their end [ms]."""

    median_ms: float
    p99_ms: float
    worst_ms: float


class Pacer:
    """Maps a monotonic clock to the rig time that is due, `factor` times real time.

    Args:
        clock: monotonic clock [ns].
        factor: seconds of rig time per second of clock.
        max_lag_ns: rig time behind which the pacer re-bases instead of catching up.
    """

    def __init__(self, clock: Clock, factor: float = 1.0, max_lag_ns: int = MAX_LAG_NS) -> None:
        self._clock = clock
        self._factor = factor
        self._max_lag_ns = max_lag_ns
        self._origin_ns = clock()
        self._origin_rig_ns = 0
        self._lateness = np.zeros(LATENESS_WINDOW)
        self._published = 0
        self.slips = 0
        """How often the pacer was re-based because it had fallen behind."""
        self.slipped_ns = 0
        """Clock time given up by re-basing [ns]."""

    @property
    def factor(self) -> float:
        """Seconds of rig time per second of clock."""
        return self._factor

    def rebase(self, produced_ns: int, factor: float | None = None) -> None:
        """Make `produced_ns` of rig time due now: at the start, after a pause, when the factor changes."""
        self._origin_ns, self._origin_rig_ns = self._clock(), produced_ns
        if factor is not None:
            self._factor = factor

    def due_ns(self, produced_ns: int) -> int:
        """Return the rig time that should have been produced by now; re-bases when `produced_ns` is too far behind."""
        due = self._origin_rig_ns + int((self._clock() - self._origin_ns) * self._factor)
        if due - produced_ns > self._max_lag_ns:
            self.slips += 1
            self.slipped_ns += int((due - produced_ns) / self._factor)
            self.rebase(produced_ns)
            return produced_ns
        return due

    def wait_ns(self, rig_ns: int) -> int:
        """Return how long until `rig_ns` is due [ns of the clock]; negative when it is overdue."""
        return int(self._deadline_ns(rig_ns)) - self._clock()

    def published(self, end_ns: int) -> None:
        """Note that the block ending at rig time `end_ns` is out."""
        self._lateness[self._published % LATENESS_WINDOW] = (self._clock() - self._deadline_ns(end_ns)) * 1e-6
        self._published += 1

    def _deadline_ns(self, rig_ns: int) -> float:
        return self._origin_ns + (rig_ns - self._origin_rig_ns) / self._factor

    def lateness(self) -> Lateness | None:
        """Return the statistics of the last blocks, or None before the first."""
        if not self._published:
            return None
        median, p99, worst = np.percentile(self._lateness[: self._published], (50, 99, 100))
        return Lateness(float(median), float(p99), float(worst))


@attrs.define
class _Reader:
    forgiven: int  # blocks up to here are owed no more
    heard_ns: int  # clock when it last said something new, or when it had nothing to say
    acknowledged: int | None = None  # blocks, counted from the start; None before it has acknowledged any


class AckWindow:
    """How far every reader of the blocks is, and how far ahead of its slowest peer the rig may run.

    A reader acknowledges by the stamp of the last block it processed, one or several at a time. Blocks are counted, so
    that "ahead" has one meaning for all. Peers are the readers that are waited for; others are only watched.

    Args:
        peers: names the acknowledgements carry.
        window: blocks that may be out and not acknowledged.
        timeout_ns: clock time after which a peer that owes an acknowledgement counts as silent.
        clock: monotonic clock [ns].
    """

    def __init__(self, peers: Iterable[str], window: int, timeout_ns: int, clock: Clock) -> None:
        self.window = window
        self.timeout_ns = timeout_ns
        self._clock = clock
        self._published = 0
        self._stamps: list[int] = []  # of the newest blocks; the last one is number self._published
        self._readers: dict[str, _Reader] = {}
        self._peers: tuple[str, ...] = ()
        self.set_peers(peers)

    @property
    def peers(self) -> tuple[str, ...]:
        """Names of the peers."""
        return self._peers

    @property
    def readers(self) -> tuple[str, ...]:
        """Names of the peers, and of everybody else who acknowledges."""
        return tuple(self._readers)

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest block that is out."""
        return self._stamps[-1] if self._stamps else None

    def set_peers(self, peers: Iterable[str]) -> None:
        """Change the peers; new ones owe nothing of what is already out."""
        before, self._peers = self._peers, tuple(peers)
        for name in set(self._peers).difference(before):
            reader = self._readers.setdefault(name, _Reader(self._published, self._clock()))
            reader.forgiven, reader.heard_ns = self._published, self._clock()
        for name in set(self._readers).difference(self._peers):
            if self._readers[name].acknowledged is None:
                del self._readers[name]

    def watch(self, name: str) -> None:
        """Take acknowledgements in this name, too, without waiting for any."""
        self._readers.setdefault(name, _Reader(0, self._clock()))

    def published(self, stamp_ns: int) -> None:
        """Note that the block with this stamp is out."""
        now = self._clock()
        for reader in self._readers.values():
            if self._owed(reader) == 0:
                reader.heard_ns = now  # owed nothing until now: its silence starts here
        self._published += 1
        self._stamps.append(stamp_ns)
        if len(self._stamps) >= 2 * KEPT:
            del self._stamps[:KEPT]

    def acknowledge(self, name: str, stamp_ns: int) -> bool:
        """Take an acknowledgement; False if it makes no sense (nobody we watch, later than any block)."""
        reader = self._readers.get(name)
        if reader is None or self.newest_ns is None or stamp_ns > self.newest_ns:
            return False
        count = self._published - len(self._stamps) + bisect.bisect_right(self._stamps, stamp_ns)
        if reader.acknowledged is None or count > reader.acknowledged:
            reader.acknowledged = count
            reader.heard_ns = self._clock()
        return True

    def room(self) -> int:
        """Return how many blocks may be published now."""
        return self.window - self.outstanding()

    def outstanding(self) -> int:
        """Return how many blocks the slowest peer has not acknowledged."""
        return max((self._owed(self._readers[name]) for name in self._peers), default=0)

    def behind(self) -> dict[str, int]:
        """Return the blocks each reader has not acknowledged."""
        return {name: self._owed(reader) for name, reader in self._readers.items()}

    def heard(self) -> tuple[str, ...]:
        """Return the readers that have acknowledged."""
        return tuple(name for name, reader in self._readers.items() if reader.acknowledged is not None)

    def silent(self) -> tuple[str, ...]:
        """Return the peers that owe an acknowledgement and said nothing for the timeout."""
        limit = self._clock() - self.timeout_ns
        owing = (name for name in self._peers if self._owed(self._readers[name]) > 0)
        return tuple(name for name in owing if self._readers[name].heard_ns < limit)

    def forgive(self) -> None:
        """Count everything as acknowledged: the operator continues without what a silent peer missed."""
        for name in self._peers:
            self._readers[name].forgiven = self._published
        self.excuse()

    def excuse(self) -> None:
        """Restart every peer's timeout: this process itself was away, so their silence means nothing."""
        for name in self._peers:
            self._readers[name].heard_ns = self._clock()

    def forget(self, name: str) -> None:
        """Drop what is known of a reader that has left; a peer still owes what it has not acknowledged."""
        reader = self._readers.pop(name)
        if name in self._peers:
            self._readers[name] = _Reader(self._published - self._owed(reader), reader.heard_ns)

    def _owed(self, reader: _Reader) -> int:
        return self._published - max(reader.acknowledged or 0, reader.forgiven)
