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
"""Pacing without a wall clock: the test sets the time."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_rig.nodes.acknowledgements import KEPT, AckWindow
from impact_rig.nodes.pacing import Pacer
from impact_rig.simtime import NS_PER_S

MS = 1_000_000


class FakeClock:
    def __init__(self) -> None:
        self.now = 123_456_789

    def __call__(self) -> int:
        return self.now


def test_the_due_time_follows_the_clock_without_drift() -> None:
    clock = FakeClock()
    pacer = Pacer(clock, factor=2.0)
    pacer.rebase(0)
    for _ in range(1000):
        clock.now += 3_333_333  # irregular wake-ups do not accumulate
        due = pacer.due_ns(int((clock.now - 123_456_789) * 2) - 10 * MS)
    assert due == 2 * 3_333_333 * 1000
    assert pacer.slips == 0


def test_the_time_base_moves_after_a_suspension_and_the_shift_is_reported() -> None:
    clock = FakeClock()
    pacer = Pacer(clock, max_lag_ns=200 * MS)
    pacer.rebase(0)
    clock.now += 200 * MS
    assert pacer.due_ns(0) == 200 * MS, "so much is caught up"
    clock.now += 1
    assert pacer.due_ns(1) == 200 * MS + 1
    assert pacer.due_ns(0) == 0, "a nanosecond more is given up"
    pacer = Pacer(clock)
    pacer.rebase(0)
    clock.now += 5 * NS_PER_S
    assert pacer.due_ns(produced_ns=100 * MS) == 100 * MS, "no burst of five seconds"
    assert (pacer.slips, pacer.slipped_ns) == (1, 4900 * MS)
    clock.now += 10 * MS
    assert pacer.due_ns(100 * MS) == 110 * MS


def test_lateness_is_measured_from_the_absolute_deadline() -> None:
    clock = FakeClock()
    pacer = Pacer(clock, factor=0.5)
    pacer.rebase(0)
    assert pacer.lateness() is None
    clock.now += 20 * MS + 700_000
    pacer.published(10 * MS)  # due after 20 ms at half speed
    late = pacer.lateness()
    assert late is not None
    assert late.worst_ms == pytest.approx(0.7)


def test_the_wait_until_a_block_is_due_is_in_clock_time() -> None:
    clock = FakeClock()
    pacer = Pacer(clock, factor=4.0)
    clock.now += 1 * MS
    assert pacer.wait_ns(10 * MS) == 2_500_000 - 1 * MS
    assert pacer.wait_ns(0) == -1 * MS


def test_the_window_follows_the_slowest_peer() -> None:
    clock = FakeClock()
    window = AckWindow(("a", "b"), 4, 3 * NS_PER_S, clock)
    for stamp in (0, 10, 20):
        window.published(stamp)
    assert window.room() == 1
    assert window.acknowledge("a", 20)
    assert window.room() == 1
    assert window.acknowledge("b", 10)
    assert window.room() == 3
    assert window.behind() == {"a": 0, "b": 1}
    assert window.acknowledge("a", 10), "an earlier one that arrives late"
    assert window.behind() == {"a": 0, "b": 1}


@pytest.mark.parametrize(("peer", "stamp"), [("nobody", 0), ("a", 21), ("", 0)])
def test_invalid_acknowledgements_are_rejected(peer: str, stamp: int) -> None:
    window = AckWindow(("a",), 4, NS_PER_S, FakeClock())
    assert not window.acknowledge("a", 0), "nothing was published yet"
    window.published(20)
    assert not window.acknowledge(peer, stamp)
    assert window.outstanding() == 1


def test_only_a_peer_with_unacknowledged_blocks_is_silent() -> None:
    clock = FakeClock()
    window = AckWindow(("a", "b"), 4, 3 * NS_PER_S, clock)
    clock.now += 100 * NS_PER_S  # a rig that pauses for long does not make its peers silent
    window.published(0)
    window.acknowledge("a", 0)
    assert window.silent() == ()
    clock.now += 3 * NS_PER_S + 1
    assert window.silent() == ("b",)
    window.excuse()
    assert window.silent() == ()
    clock.now += 4 * NS_PER_S
    window.waive()
    assert (window.silent(), window.room()) == ((), 4)
    for stamp in range(1, 9):
        window.published(stamp)
        window.acknowledge("a", stamp)
    clock.now += 4 * NS_PER_S
    window.forget("b")  # the middleware notices after 20 s that it is gone
    window.published(9)
    window.acknowledge("a", 9)
    assert (window.silent(), window.room(), window.waived()) == ((), 4, ("b",)), "it goes on without b"
    window.acknowledge("b", 0)
    assert window.waived() == ()
    assert window.room() < 4, "from its next word on it is waited for again"
    window.forgive(["b"])
    assert (window.room(), window.heard_ns("b")) == (4, clock.now)


def test_a_rig_never_leaves_all_its_peers_behind() -> None:
    """If the last peer becomes silent after another one was waived, the rig goes on for one more window only."""
    clock = FakeClock()
    window = AckWindow(("a", "b"), 4, NS_PER_S, clock)
    window.published(0)
    window.acknowledge("b", 0)
    for stamp in (1, 2):
        clock.now += 2 * NS_PER_S
        window.waive()
        assert window.waived() == ("a",)
        window.published(stamp)
    for stamp in (3, 4, 5):
        window.published(stamp)
    assert window.room() == 0


def test_a_rig_left_with_a_waived_peer_alone_waits_for_it_again() -> None:
    """The other peers may be removed from `time.peers`: without any to wait for, blocks would be lost without limit."""
    clock = FakeClock()
    window = AckWindow(("a", "b"), 4, NS_PER_S, clock)
    window.published(0)
    window.acknowledge("b", 0)
    clock.now += 2 * NS_PER_S
    window.waive()
    assert window.waived() == ("a",)
    window.set_peers(("a",))
    for stamp in (1, 2, 3, 4):
        window.published(stamp)
    assert (window.waived(), window.room()) == ((), 0)


def test_a_window_without_peers_always_has_room() -> None:
    window = AckWindow((), 4, NS_PER_S, FakeClock())
    for stamp in range(100):
        window.published(stamp)
    assert (window.room(), window.silent()) == (4, ())


def test_the_rig_waits_again_for_a_peer_that_is_listed_again() -> None:
    """A peer that was given up is waited for again when it is listed again; otherwise, blocks are lost to it."""
    clock = FakeClock()
    window = AckWindow(("a", "b"), 4, NS_PER_S, clock)
    window.published(0)
    window.acknowledge("b", 0)
    window.published(1)
    window.acknowledge("a", 1)
    clock.now += 2 * NS_PER_S
    window.waive()
    assert window.waived() == ("b",)
    for peers in (("a",), ("a", "b")):
        window.set_peers(peers)
    window.published(2)
    window.acknowledge("a", 2)
    assert (window.waived(), window.room()) == ((), 3)


def test_new_peers_need_not_acknowledge_earlier_blocks() -> None:
    window = AckWindow(("a",), 4, NS_PER_S, FakeClock())
    window.published(0)
    window.set_peers(("a", "b"))
    assert window.behind() == {"a": 1, "b": 0}
    window.set_peers(("b",))
    assert window.room() == 4
    window.watch("c")
    window.acknowledge("c", 0)
    for stamp in (1, 2, 3):
        window.published(stamp)
    assert window.behind()["c"] == 3, "watched before"
    window.set_peers(("c",))
    assert window.room() == 4


@given(st.lists(st.tuples(st.sampled_from(["publish", "a", "b"]), st.integers(-5, 400)), max_size=200))
def test_no_sequence_of_acknowledgements_overruns_the_window(steps: list[tuple[str, int]]) -> None:
    """The rig is at most `window` blocks ahead of what each peer has acknowledged, whatever peers send."""
    window = AckWindow(("a", "b"), 3, NS_PER_S, FakeClock())
    published, last = 0, {"a": -1, "b": -1}
    for who, stamp in steps:
        if who == "publish":
            if window.room() > 0:
                window.published(10 * published)
                published += 1
        elif window.acknowledge(who, stamp):
            last[who] = max(last[who], stamp)
        for name, seen in last.items():
            acknowledged = 0 if seen < 0 else min(seen // 10 + 1, published)
            assert window.behind()[name] == published - acknowledged
        assert 0 <= window.room() <= 3


def test_a_reader_that_is_not_a_peer_is_counted_too() -> None:
    window = AckWindow(("peer",), 4, NS_PER_S, FakeClock())
    for stamp in range(10):
        window.published(stamp)
    window.acknowledge("peer", 9)
    assert not window.acknowledge("plotter", 3), "it is not followed yet"
    window.watch("plotter")
    for stamp in (3, 4, 7, 6, 7):
        assert window.acknowledge("plotter", stamp)
    assert window.behind() == {"peer": 0, "plotter": 2}
    assert window.heard() == ("peer", "plotter")
    assert (window.room(), window.silent()) == (4, ()), "only peers are waited for"
    window.forget("plotter")
    assert window.readers == ("peer",)


def test_an_acknowledgement_covers_all_earlier_blocks() -> None:
    window = AckWindow(("a",), 4, NS_PER_S, FakeClock())
    for stamp in range(4):
        window.published(stamp)
    window.acknowledge("a", 2)
    assert (window.behind(), window.room()) == ({"a": 1}, 3)


def test_a_peer_that_returns_need_not_acknowledge_blocks_that_were_given_up() -> None:
    window = AckWindow(("a",), 4, NS_PER_S, FakeClock())
    window.published(0)
    window.acknowledge("a", 0)
    for stamp in (1, 2, 3):
        window.published(stamp)
    window.forget("a")
    assert window.behind() == {"a": 3}, "a peer is waited for, there or not"
    window.forgive(["a"])
    window.published(4)
    window.acknowledge("a", 4)
    assert window.behind() == {"a": 0}


def test_remembered_stamps_are_bounded() -> None:
    window = AckWindow((), 1, NS_PER_S, FakeClock())
    window.watch("late")
    for stamp in range(3 * KEPT):
        window.published(stamp)
    assert window.acknowledge("late", 0)
    assert KEPT <= window.behind()["late"] <= 2 * KEPT, "further behind than is remembered"
