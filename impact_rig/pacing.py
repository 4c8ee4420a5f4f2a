"""When blocks are due: realtime pacing against an injected clock, and the acknowledgement window of the other modes.

Nothing here sleeps or knows ROS: whoever owns the loop asks how many blocks are due and says when they are out.
Deadlines are computed from the start, never accumulated, so pacing does not drift; a process that was suspended is
re-based and says by how much.
"""

from __future__ import annotations

import bisect
from collections import deque
from collections.abc import Callable, Iterable

import attrs
import numpy as np

from impact_rig.simtime import NS_PER_S

Clock = Callable[[], int]
"""A monotonic clock [ns], e.g. `time.monotonic_ns`."""

MAX_LAG_NS = NS_PER_S
"""Rig time: further behind than this, catching up would overrun every subscriber's queue; realtime is re-based."""
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
        self._lateness: deque[float] = deque(maxlen=LATENESS_WINDOW)
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
        self._lateness.append((self._clock() - self._deadline_ns(end_ns)) * 1e-6)

    def _deadline_ns(self, rig_ns: int) -> float:
        return self._origin_ns + (rig_ns - self._origin_rig_ns) / self._factor

    def lateness(self) -> Lateness | None:
        """Return the statistics of the last blocks, or None before the first."""
        if not self._lateness:
            return None
        median, p99, worst = np.percentile(np.array(self._lateness), (50, 99, 100))
        return Lateness(float(median), float(p99), float(worst))


@attrs.define
class _Peer:
    acknowledged: int  # blocks, counted from the start
    heard_ns: int  # clock when it last said something new, or when it had nothing to say


class AckWindow:
    """How far ahead of its slowest peer the rig may run.

    A peer acknowledges by the stamp of the last block it processed. Blocks are counted, so that "ahead" has one meaning
    for all peers.

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
        self._first = 0  # count of the block whose stamp is self._stamps[0]
        self._stamps: list[int] = []
        self._last_stamp: int | None = None
        self._peers = {name: _Peer(0, clock()) for name in peers}

    @property
    def peers(self) -> tuple[str, ...]:
        """Names of the peers."""
        return tuple(self._peers)

    def set_peers(self, peers: Iterable[str]) -> None:
        """Change the peers; new ones owe nothing of what is already out."""
        self._peers = {name: self._peers.get(name) or _Peer(self._published, self._clock()) for name in peers}
        self._trim()

    def published(self, stamp_ns: int) -> None:
        """Note that the block with this stamp is out."""
        now = self._clock()
        for peer in self._peers.values():
            if peer.acknowledged == self._published:
                peer.heard_ns = now  # owed nothing until now: its silence starts here
        self._published += 1
        self._last_stamp = stamp_ns
        if self._peers:
            self._stamps.append(stamp_ns)

    def acknowledge(self, peer: str, stamp_ns: int) -> bool:
        """Take an acknowledgement; False if it makes no sense (unknown peer, stamp never published)."""
        state = self._peers.get(peer)
        if state is None or self._last_stamp is None or stamp_ns > self._last_stamp:
            return False
        count = self._first + bisect.bisect_right(self._stamps, stamp_ns)
        if count > state.acknowledged:
            state.acknowledged = count
            state.heard_ns = self._clock()
            self._trim()
        return True

    def room(self) -> int:
        """Return how many blocks may be published now."""
        return self.window - self.outstanding()

    def outstanding(self) -> int:
        """Return how many blocks the slowest peer has not acknowledged."""
        return max((self._published - peer.acknowledged for peer in self._peers.values()), default=0)

    def behind(self) -> dict[str, int]:
        """Return the blocks each peer has not acknowledged."""
        return {name: self._published - peer.acknowledged for name, peer in self._peers.items()}

    def silent(self) -> tuple[str, ...]:
        """Return the peers that owe an acknowledgement and said nothing for the timeout."""
        limit = self._clock() - self.timeout_ns
        return tuple(
            name for name, peer in self._peers.items() if peer.acknowledged < self._published and peer.heard_ns < limit
        )

    def forgive(self) -> None:
        """Count everything as acknowledged: the operator continues without what a silent peer missed."""
        for peer in self._peers.values():
            peer.acknowledged, peer.heard_ns = self._published, self._clock()
        self._trim()

    def excuse(self) -> None:
        """Restart every peer's timeout: this process itself was away, so their silence means nothing."""
        for peer in self._peers.values():
            peer.heard_ns = self._clock()

    def _trim(self) -> None:
        done = min((peer.acknowledged for peer in self._peers.values()), default=self._published) - self._first
        if done > 0:
            del self._stamps[:done]
            self._first += done
