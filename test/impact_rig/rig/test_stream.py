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
"""A stream drives the rig with the samples that arrive in time; the journal and the samples give the run again."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from kits.rig import TICK, config, impacts, same, samples
from numpy.typing import NDArray

from impact_rig.errors import CommandError, ConfigError
from impact_rig.rig import Block, InputKind, Rig, resimulate
from impact_rig.rig.journal import JournalEntry
from impact_rig.rig.resimulation import Sent
from impact_rig.simtime import NS_PER_S

RATE_HZ = 10_000
SECONDS = 2
TIME = np.arange(SECONDS * RATE_HZ) / RATE_HZ
WAVE = 0.6 * np.sin(2.0 * np.pi * 9.1 * TIME) + 0.01 * np.random.default_rng(4).standard_normal(len(TIME))
Blocks = list[tuple[int, NDArray[np.float64]]]


def stream_rig(**values: object) -> Rig:
    return Rig(config(drive__waveform="stream", drive__amplitude=0.0, **values))


def in_blocks(size: int) -> Blocks:
    return [(first, WAVE[first : first + size]) for first in range(0, len(WAVE), size)]


def shuffled(blocks: Blocks, within: int) -> Blocks:
    order = np.argsort(np.arange(len(blocks)) + np.random.default_rng(2).uniform(0, within, len(blocks)))
    return [blocks[k] for k in order]


def played(sent: Blocks, step: int = TICK, until_ns: int = SECONDS * NS_PER_S, **values: object) -> list[Block]:
    """Feed the blocks as soon as the buffer accepts them; advance as far as there are samples."""
    rig, found, coming = stream_rig(**values), [], list(sent)
    while rig.frontier_ns < until_ns:
        while coming and coming[0][0] + len(coming[0][1]) <= rig.stream.played + RATE_HZ:
            rig.feed(*coming.pop(0))
        found += rig.advance(min(rig.start_ns + until_ns, rig.frontier_ns + step))
    return found


@pytest.fixture(scope="module")
def reference() -> list[Block]:
    return played(in_blocks(100))


@pytest.mark.parametrize(
    ("sent", "step"),
    [
        (in_blocks(1), TICK),
        (in_blocks(7), 3 * TICK),
        (in_blocks(5_000), 20 * TICK),
        (shuffled(in_blocks(100), 30), TICK),
        ([block for block in in_blocks(250) for _ in range(2)], 2 * TICK),
        ([block for first in in_blocks(500) for block in ((first[0], -first[1]), first)], TICK),
    ],
    ids=["1", "7", "5000", "shuffled", "twice", "replaced"],
)
@pytest.mark.repeats
def test_the_order_and_size_of_sample_blocks_do_not_matter(reference, sent, step):
    found = played(sent, step)
    assert same(samples(found), samples(reference))
    assert same(impacts(found), impacts(reference))


@pytest.mark.heavy
def test_the_scan_rate_does_not_move_an_impact(reference):
    found = played(in_blocks(100), daq__rate_hz=25_600)
    assert same(impacts(found), impacts(reference))


def rows(rig: Rig, entries: list[JournalEntry]) -> list[tuple[str, float, str]]:
    entries += rig.take_journal() if not entries else []
    return [(e.name, e.value, e.text) for e in entries if e.kind is InputKind.STREAM]


def test_missing_samples_ramp_to_zero_and_are_reported():
    rig = stream_rig()
    rig.feed(0, np.full(500, 0.3))
    blocks = rig.advance(NS_PER_S // 5)
    rig.feed(3_000, np.full(2_000, 0.1))
    rig.feed(5_000, [])
    blocks += rig.advance(NS_PER_S)
    current = np.concatenate([block.scan.rows["current"] for block in blocks])
    assert current[300:490] == pytest.approx(0.3, abs=0.02)
    assert current[1_000] == pytest.approx(0.15, abs=0.02), "half of a ramp of 0.1 s"
    assert current[1_600:2_900] == pytest.approx(0.0, abs=0.02)
    assert current[3_100:4_900] == pytest.approx(0.1, abs=0.02)
    found = rows(rig, [])
    assert [(key, value) for key, value, _ in found] == [
        ("begin", 0.0), ("crc32", 0.0), ("end", 500.0), ("begin", 3_000.0), ("crc32", 3_000.0), ("end", 5_000.0)
    ]  # fmt: skip
    assert [text for key, _, text in found if key == "end"] == ["underrun", "ended"]
    assert rig.stream.missing == 2_500


@pytest.mark.heavy
@pytest.mark.parametrize("order", list(itertools.permutations(range(4))))
def test_the_end_of_a_stream_may_arrive_in_any_order(order):
    """The stream consists of two pieces with a pause, and their ends.

    A later block or end must not replace an earlier end; otherwise, a pause that the controller requested is an
    underrun.
    """
    rig = stream_rig(drive__on_underrun="trip")
    blocks = [(0, np.full(500, 0.3)), (500, []), (1_500, np.full(500, 0.1)), (2_000, [])]
    for i in order:
        rig.feed(*blocks[i])
    rig.advance(NS_PER_S)
    found = [(key, value, text) for key, value, text in rows(rig, []) if key != "crc32"]
    pieces = [("begin", 0.0, ""), ("end", 500.0, "ended"), ("begin", 1_500.0, ""), ("end", 2_000.0, "ended")]
    assert found == pieces
    assert rig.latched is None
    assert rig.stream.missing == 0


def test_a_sample_replaces_an_end():
    rig = stream_rig()
    rig.feed(0, np.full(500, 0.3))
    rig.feed(500, [])
    rig.feed(400, np.full(300, 0.3))
    rig.feed(700, [])
    rig.advance(NS_PER_S)
    assert [(value, text) for key, value, text in rows(rig, []) if key == "end"] == [(700.0, "ended")]


def test_the_reaction_to_an_underrun_can_be_configured():
    holding, tripping = stream_rig(drive__on_underrun="hold"), stream_rig(drive__on_underrun="trip")
    for rig in (holding, tripping):
        rig.feed(0, np.full(500, 0.3))
    kept = holding.advance(NS_PER_S // 2)[-1].scan.rows["current"]
    assert kept == pytest.approx(0.3, abs=0.02)
    assert tripping.advance(NS_PER_S // 2)[-1].scan.rows["current"] == pytest.approx(0.0, abs=0.02)
    assert tripping.latched is not None
    assert tripping.latched.startswith("underrun: sample 500")
    with pytest.raises(CommandError, match="latched"):
        tripping.feed(6_000, [0.1])
    tripping.clear_trip()
    tripping.feed(6_000, [0.1])


@pytest.mark.heavy
def test_an_underrun_does_not_hide_a_trip_in_the_same_tick():
    """The row of that tick must report the over-travel, not only the underrun."""
    limits = {"drive__on_underrun": "trip", "shaker__travel_limit_m": 1e-3}
    whole, cut = stream_rig(**limits), stream_rig(**limits)
    whole.feed(0, 10.0 * WAVE[:RATE_HZ])
    whole.advance(NS_PER_S)
    (over,) = [row for row in whole.take_journal() if row.kind is InputKind.TRIP]
    assert over.name == "over_travel"
    last = over.sample - 20  # in the tick of the trip
    cut.feed(0, 10.0 * WAVE[:last])
    cut.advance(NS_PER_S)
    journal = cut.take_journal()
    assert [(row.name, row.value, row.text) for row in journal if row.name == "end"] == [("end", last, "underrun")]
    (trip,) = [row for row in journal if row.kind is InputKind.TRIP]
    assert (trip.name, trip.sample) == (over.name, over.sample)


@pytest.mark.parametrize(
    ("first", "values", "says"),
    [
        (0, [0.1, np.nan], r"got nan A peak in row 1, counted from 0"),
        (0, [np.inf], r"each sample must have a current >= -21\.21 and <= 21\.21 A peak"),
        (0, [0.1] * 99 + [22.0], r"a current >= -21\.21 and <= 21\.21 A .*, got 22 A peak in row 99, counted from 0"),
        (30_000, [0.1], r"3\.\d+ s ahead of the rig, beyond drive.stream_buffer_s = \d+ s: send"),
        (0, [[0.1]], "shape"),
    ],
)
def test_an_invalid_block_is_rejected_as_a_unit(first, values, says):
    rig = stream_rig()
    with pytest.raises(CommandError, match=says):
        rig.feed(first, values)
    assert rig.stream.buffered() == 0
    assert rig.stream_state().rows["refused"] == 1
    assert not np.any(rig.advance(NS_PER_S // 10)[-1].monitor_states["current"])


def test_late_samples_are_dropped_and_counted():
    rig = stream_rig()
    rig.advance(NS_PER_S // 10)
    wanted = rig.stream.played
    assert rig.feed(wanted - 30, np.full(100, 0.1)) == 30
    state = rig.stream_state()
    assert state.rows["late"] == 30
    assert state.rows["buffered"] == 70
    assert state.stamp_ns == rig.start_ns + wanted * NS_PER_S // RATE_HZ


def test_a_stop_drops_buffered_samples_and_rejects_further_ones():
    rig = stream_rig()
    rig.feed(0, WAVE[:10_000])
    rig.advance(NS_PER_S // 5)
    rig.stop()
    with pytest.raises(CommandError, match="emergency stop"):
        rig.feed(5_000, WAVE[:10])
    blocks = rig.advance(NS_PER_S // 2)
    assert blocks[-1].scan.rows["current"] == pytest.approx(0.0, abs=0.02)
    assert [text for key, _, text in rows(rig, []) if key == "end"] == ["stopped"]
    assert rig.blocks_with_samples(7) == 7, "a stopped rig waits for no samples"


@pytest.mark.heavy
def test_the_interlock_covers_the_current_between_its_samples():
    """A current that is zero at every millisecond still has an rms of 7.4 A."""
    rig = stream_rig(shaker__current_limit_a_rms=6.0, sphere__present=False)
    number = np.arange(20_000)
    rig.feed(0, np.where(number % 10 == 0, 0.0, np.where(number // 10 % 2, -8.0, 8.0)))
    rig.advance(2 * NS_PER_S)
    assert rig.latched is not None
    assert rig.latched.startswith("over_current")


def test_a_stream_rejects_commands_and_other_drives_reject_samples():
    with pytest.raises(CommandError, match="shaker/waveform"):
        stream_rig().accept(amplitude=0.1)
    with pytest.raises(CommandError, match="the drive is sine"):
        Rig(config()).feed(0, [0.1])
    with pytest.raises(ConfigError, match="first_order"):
        stream_rig(drive__kind="prescribed", drive__stream_hold="zero_order")


def test_the_rig_reports_for_how_many_blocks_it_has_samples():
    rig = stream_rig()
    assert rig.blocks_with_samples(50) == 0
    rig.feed(0, WAVE[:1_001])
    assert rig.blocks_with_samples(50) == 10
    rig.feed(1_001, [])
    assert rig.blocks_with_samples(50) == 50
    assert Rig(config()).blocks_with_samples(50) == 50


def eventful() -> tuple[Rig, list[Block], Blocks]:
    """Run in which samples are late, replaced and missing, the shaker is stopped, and parameters change."""
    rig, sent, found = stream_rig(), [], []

    def send(first: int, values: NDArray[np.float64]) -> None:
        sent.append((first, values))
        try:
            rig.feed(first, values)
        except CommandError:
            return

    send(0, WAVE[:3_000])
    send(1_000, 0.5 * WAVE[1_000:2_000])
    found += rig.advance(NS_PER_S // 2)
    send(6_000, WAVE[:2_000])
    send(7_000, np.full(10, np.nan))
    found += rig.advance(NS_PER_S * 7 // 10)
    rig.stop()
    send(7_500, WAVE[:500])
    found += rig.advance(NS_PER_S)
    rig.clear_trip()
    rig.configure({"barriers.gap_m": 0.004})
    send(11_000, WAVE[:9_000])
    found += rig.advance(3 * NS_PER_S // 2)
    send(20_000, WAVE[:0])
    return rig, found + rig.advance(5 * NS_PER_S // 2), sent


@pytest.mark.heavy
def test_journal_and_samples_reproduce_the_run_bit_for_bit():
    rig, blocks, sent = eventful()
    journal = rig.take_journal()
    waveform = [Sent(first * NS_PER_S // RATE_HZ, values) for first, values in sent]
    again = [block for block, _ in zip(resimulate(journal, waveform=waveform), blocks, strict=False)]
    assert same(samples(again), samples(blocks))
    assert same(impacts(again), impacts(blocks))
    with pytest.raises(ConfigError, match=r"lacks sample 11000 of shaker/waveform, which drove the rig 1\.100000 s"):
        for _ in zip(resimulate(journal, waveform=waveform[:-2]), blocks, strict=False):
            pass


def test_samples_that_a_reset_may_have_discarded_are_replaced_by_others():
    rig = stream_rig()
    rig.feed(0, WAVE[:3_000])
    blocks = rig.advance(NS_PER_S // 5)
    doubtful = Sent(rig.start_ns, 0.5 * WAVE[:3_000], is_doubtful=True)
    late = Sent(rig.start_ns, WAVE[:3_000], blocks[-1].end_ns)  # overtaken by its scans
    again = list(itertools.islice(resimulate(rig.take_journal(), waveform=[doubtful, late]), len(blocks)))
    assert same(samples(again), samples(blocks))
