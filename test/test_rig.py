"""The rig without ROS: one time base, deterministic commands, a journal that tells everything."""

from __future__ import annotations

import contextlib
import math

import attrs
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.lib.recfunctions import repack_fields

from impact_rig.blocks import CHANNELS, Table
from impact_rig.config import RigConfig, from_flat, to_flat
from impact_rig.errors import CommandError, ConfigError
from impact_rig.instruments.faults import Fault
from impact_rig.rig import Block, Rig, resimulate
from impact_rig.rig.journal import Kind, read, short_key, values_of
from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S, stamp_ns

TICK = COMMAND_GRID_NS
START_NS = 1_700_000_000_123_456_789


def config(**values: object) -> RigConfig:
    """A rig that hits its walls within half a second: resonance, 2 mm gap; keys with `__` for the point."""
    chosen = {"barriers.gap_m": 0.002, "drive.amplitude": 0.52, **{k.replace("__", "."): v for k, v in values.items()}}
    return from_flat(RigConfig(), chosen)


def samples(blocks: list[Block]) -> np.ndarray:
    """All scans of the blocks without their times, as bytes-comparable rows."""
    rows = np.concatenate([block.scan.rows for block in blocks])
    return repack_fields(rows[[*CHANNELS, "status"]])


def impacts(blocks: list[Block]) -> np.ndarray:
    """All true contacts, columns that do not depend on the block they were reported in."""
    parts = [block.impacts.rows for block in blocks if block.impacts is not None]
    rows = np.concatenate(parts)
    return repack_fields(rows[[name for name in rows.dtype.names if name != "time"]])


def same(one: np.ndarray, other: np.ndarray) -> bool:
    """Bit for bit."""
    return one.tobytes() == other.tobytes()


@pytest.fixture(scope="module")
def reference() -> list[Block]:
    return Rig(config()).advance(60 * TICK)


# One time base


@given(st.lists(st.integers(1, 130_000_000), min_size=1, max_size=12))
@settings(max_examples=5)
def test_the_way_advance_is_called_changes_no_bit(reference: list[Block], steps: list[int]) -> None:
    rig, blocks, now = Rig(config()), [], 0
    for step in steps:
        now = min(now + step, 60 * TICK)
        blocks += rig.advance(now)
    blocks += rig.advance(60 * TICK)
    assert [block.number for block in blocks] == list(range(60))
    assert same(samples(blocks), samples(reference))
    assert same(impacts(blocks), impacts(reference))
    for one, other in zip(blocks, reference, strict=True):
        assert same(one.monitor, other.monitor)
        assert one.scan.stamp_ns == other.scan.stamp_ns


@pytest.mark.parametrize("block_scans", [1, 37, 250, 6000])
def test_block_length_changes_no_scan_and_no_impact(reference: list[Block], block_scans: int) -> None:
    rig = Rig(config(daq__block_scans=block_scans))
    blocks = rig.advance(60 * TICK)
    scans = samples(blocks)
    assert len(blocks) == 6000 // block_scans
    assert same(scans, samples(reference)[: len(scans)])
    found = impacts(blocks)
    assert len(found) > 5
    assert same(found, impacts(reference)[: len(found)])


@pytest.mark.parametrize("rate_hz", [4000, 25_600, 50_000])
def test_the_rate_moves_no_impact(reference: list[Block], rate_hz: int) -> None:
    blocks = Rig(config(daq__rate_hz=rate_hz)).advance(61 * TICK)
    found, expected = impacts(blocks), impacts(reference)
    assert len(expected) > 5
    assert same(found[: len(expected)], expected)


@pytest.mark.parametrize("rate_hz", [10_000, 25_600, 44_100])
def test_stamps_are_computed_from_the_index(rate_hz: int) -> None:
    """At 25 600 S/s a period is 39 062.5 ns: adding it up would drift."""
    blocks = Rig(config(daq__rate_hz=rate_hz, daq__block_scans=97), START_NS).advance(START_NS + NS_PER_S)
    assert len(blocks) == rate_hz // 97
    for k, block in enumerate(blocks):
        assert block.first_sample == 97 * k
        assert block.scan.stamp_ns == START_NS + 97 * k * NS_PER_S // rate_hz
        assert block.end_ns == START_NS + 97 * (k + 1) * NS_PER_S // rate_hz
        assert np.array_equal(block.scan.rows["time"], np.arange(97) / rate_hz)


def test_a_block_comes_when_it_is_complete_and_not_before() -> None:
    rig = Rig(config(), START_NS)
    assert rig.advance(START_NS + TICK - 1) == []
    assert [block.number for block in rig.advance(START_NS + TICK)] == [0]
    assert rig.advance(START_NS + TICK) == []
    assert rig.frontier_ns == START_NS + TICK


def test_a_long_block_is_simulated_tick_by_tick() -> None:
    """So that a command in realtime waits for one tick, not for a block."""
    rig = Rig(config(daq__block_scans=10_000))
    assert rig.advance(25 * TICK + 1) == []
    assert rig.frontier_ns == 25 * TICK


def test_a_seed_changes_noise_and_errors_but_not_one_impact(reference: list[Block]) -> None:
    other = Rig(config(daq__seed=2)).advance(60 * TICK)
    assert same(impacts(other), impacts(reference))
    for name in CHANNELS:
        assert not np.array_equal(samples(other)[name], samples(reference)[name])
    for one, two in zip(other, reference, strict=True):
        assert same(one.monitor, two.monitor), "the truth knows no noise"


def test_the_clock_error_scales_the_physics_beneath_the_samples() -> None:
    """A scan clock that is 1000 ppm slow spans more of true time: the drive seems 1000 ppm faster."""
    slow = Rig(config(daq__clock_error_ppm=1000.0, instruments__ideal=True, sphere__present=False))
    current = samples(slow.advance(100 * TICK))["current"][2000:]
    seconds = (np.arange(len(current)) + 2000) / 10_000
    expected = 0.52 * np.sin(2 * np.pi * 9.1 * 1.001 * seconds)
    assert np.abs(current - expected).max() < 1e-9


# Commands


def test_a_command_acts_at_the_first_instant_not_yet_simulated(reference: list[Block]) -> None:
    rig = Rig(config())
    blocks = rig.advance(20 * TICK + 3_000_000)
    applied = rig.command(frequency_hz=11.0)
    row = applied.rows[0]
    assert (int(row["sample"]), applied.stamp_ns) == (2000, 20 * TICK)
    assert (row["frequency"], row["current"]) == (11.0, 0.52)
    assert row["phase"] == pytest.approx(math.fmod(2 * math.pi * 9.1 * 0.2, 2 * math.pi), abs=1e-12)
    blocks += rig.advance(40 * TICK)
    got, before = samples(blocks), samples(reference)
    assert same(got[:2000], before[:2000])
    assert not same(got[2000:2010], before[2000:2010]) or not same(got[2000:2400], before[2000:2400])


def test_the_drive_has_no_jump_of_phase_at_a_command() -> None:
    rig = Rig(config(instruments__ideal=True))
    blocks = rig.advance(10 * TICK)
    rig.command(frequency_hz=50.0)
    blocks += rig.advance(20 * TICK)
    current = samples(blocks)["current"]
    fastest = 0.52 * 2 * math.pi * 50.0 / 10_000
    assert np.abs(np.diff(current)).max() <= fastest * (1 + 1e-9)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ({"frequency_hz": math.nan}, ["frequency", "5", "200", "nan"]),
        ({"frequency_hz": math.inf}, ["frequency", "inf"]),
        ({"frequency_hz": 4.99}, ["frequency", "4.99"]),
        ({"frequency_hz": 1e308}, ["frequency", "1e+308"]),
        ({"frequency_hz": -9.1}, ["frequency", "-9.1"]),
        ({"current_a": math.nan}, ["current", "nan"]),
        ({"current_a": -0.1}, ["current", "-0.1"]),
        ({"current_a": 15.0 * math.sqrt(2) * 1.0001}, ["current", "21.21", "15 A", "current_limit_a_rms"]),
        ({"current_a": math.inf}, ["current", "inf"]),
        ({"frequency_hz": 9.0, "current_a": math.nan}, ["current", "nan"]),
    ],
)
def test_a_refused_command_names_value_and_range_and_changes_nothing(
    command: dict[str, float], words: list[str]
) -> None:
    rig = Rig(config())
    rig.take_journal()
    with pytest.raises(CommandError) as refusal:
        rig.command(**command)
    for word in words:
        assert word in str(refusal.value)
    assert (rig.frequency_hz, rig.amplitude) == (9.1, 0.52)
    assert rig.take_journal() == []


def test_the_initial_drive_is_checked_like_a_command() -> None:
    with pytest.raises(ConfigError, match=r"drive: current must be"):
        Rig(config(drive__amplitude=30.0))


@pytest.fixture(scope="module")
def hammered() -> Rig:
    return Rig(config())


@given(st.floats(), st.floats())
@settings(max_examples=2000)
def test_any_command_is_accepted_within_range_or_refused(hammered: Rig, frequency: float, current: float) -> None:
    """Whatever is sent, the drive stays finite and within the shaker's limits."""
    for command in ({"frequency_hz": frequency}, {"current_a": current}, {"frequency_hz": 5 + abs(frequency) % 195}):
        with contextlib.suppress(CommandError):
            hammered.command(**command)
    assert 5 <= hammered.frequency_hz <= 200
    assert 0 <= hammered.amplitude <= 15 * math.sqrt(2)
    assert all(0 <= table.rows["phase"][0] < 2 * math.pi for table in hammered.take_applied())
    hammered.take_journal()


_NAMES = st.sampled_from([*to_flat(RigConfig()), "barriers.gap", "", "x" * 400])
_VALUES = st.one_of(st.floats(), st.integers(), st.booleans(), st.text(max_size=8), st.none(), st.tuples(st.text()))


@given(st.dictionaries(_NAMES, _VALUES, min_size=1, max_size=3))
@example({"structure.mass_kg": 1.8e14, "shaker.damping_n_s_m": 1.8e14})  # the sphere touches without end
@settings(max_examples=2000)
def test_any_change_of_parameters_is_taken_whole_or_refused_whole(hammered: Rig, changes: dict[str, object]) -> None:
    before = hammered.config
    try:
        after = hammered.configure(changes)
    except (ConfigError, CommandError):
        assert hammered.config is before
        return
    scans = samples(hammered.advance(hammered.frontier_ns + TICK))
    assert all(np.isfinite(scans[name]).all() for name in CHANNELS), changes
    values = to_flat(after)
    for name, value in changes.items():
        if not isinstance(values[name], tuple):  # an empty text in a list of names means nothing
            assert values[name] == (float(value) if isinstance(values[name], float) else value)
    # put back: a rig that is slow by right, with a shaker at MHz, would slow down all that come after
    default = to_flat(config())
    hammered.configure({name: default[name] for name in changes if name in default})
    hammered.take_journal()


# Parameters at run time


def again(rig_blocks: list[Block], journal: list[Table]) -> None:
    """Every scan of the blocks must come out of the journal again."""
    for block, copy in zip(rig_blocks, resimulate(journal), strict=False):
        assert block.scan.rows.tobytes() == copy.scan.rows.tobytes(), f"block {block.number}"


def test_two_changes_of_one_instant_are_two() -> None:
    """There and back: nothing differs in the end, but the sphere was put to its start."""
    rig = Rig(config(drive__amplitude=0.52, barriers__gap_m=0.006))
    blocks = rig.advance(300 * TICK)
    rig.configure({"barriers.gap_m": 0.004, "contact.law": "hunt_crossley"})
    rig.configure({"barriers.gap_m": 0.006, "contact.law": "flores"})
    blocks += rig.advance(400 * TICK)
    again(blocks, rig.take_journal())


def test_faults_come_and_go_with_the_list_of_planned_ones() -> None:
    """Counted from when it is set; journaled as what it is, so a re-simulation has it too."""
    rig = Rig(config(instruments__faults__planned=["stuck channel=base start_s=0.005"]))
    blocks = rig.advance(10 * TICK)
    rig.configure({"instruments.faults.planned": ["dropout channel=laser start_s=0.02 duration_s=0.03"]})
    blocks += rig.advance(30 * TICK)
    rows = np.concatenate([block.faults.rows for block in blocks if block.faults is not None])
    found = [(row["kind"], row["channel"], row["sample"], row["active"], row["id"]) for row in rows]
    assert found == [
        (b"stuck", b"base", 50, 1, 1),
        (b"stuck", b"base", 1000, 0, 1),
        (b"dropout", b"laser", 1200, 1, 2),
        (b"dropout", b"laser", 1500, 0, 2),
    ]
    with pytest.raises(ConfigError, match="fault kind must be one of"):
        rig.configure({"instruments.faults.planned": ["explosion"]})
    rig.configure({"instruments.faults.planned": []})  # it has ended: nothing to clear
    blocks += rig.advance(40 * TICK)
    again(blocks, rig.take_journal())
    rig.reset()
    assert all(block.faults is None for block in rig.advance(rig.frontier_ns + 10 * TICK))


def test_a_blank_line_plans_no_fault() -> None:
    """Neither at the start, where it takes no number of the board, nor when it comes later."""
    stuck, dropout = "stuck channel=base", "dropout channel=laser"
    rig = Rig(config(instruments__faults__planned=[" ", stuck, dropout]))
    rig.configure({"instruments.faults.planned": [" ", "  ", stuck]})
    blocks = rig.advance(20 * TICK)
    rows = np.concatenate([block.faults.rows for block in blocks if block.faults is not None])
    assert [(row["kind"], row["active"]) for row in rows] == [(b"stuck", 1)]


def test_a_trip_for_current_is_cleared_at_once() -> None:
    """What was averaged before belongs to the past."""
    rig = Rig(config(drive__amplitude=0.52, sphere__present=False))
    rig.advance(500 * TICK)
    rig.configure({"shaker.current_limit_a_rms": 0.1})
    rig.advance(600 * TICK)
    assert rig.latched is not None
    rig.clear_trip()
    rig.advance(700 * TICK)
    assert rig.latched is None


def test_a_pluck_may_go_further_than_the_table() -> None:
    rig = Rig(config())
    rig.pluck(0.008)
    assert abs(rig.advance(2 * TICK)[0].scan.rows["laser"][0]) > 0.0075
    with pytest.raises(CommandError, match="must be finite"):
        rig.pluck(math.inf)


def test_a_gap_change_rests_the_sphere_at_its_start() -> None:
    rig = Rig(config(output__monitor_rate_hz=200.0))
    before = rig.advance(50 * TICK)
    rig.configure({"barriers.gap_m": 0.008})
    after = rig.advance(51 * TICK)[0].monitor[0]
    assert after["x_2"] - after["x_1"] == pytest.approx(-0.004, abs=1e-15)
    last = before[-1].monitor[-1]
    gone_on = last["x_1"] + last["v_1"] * 5e-3
    assert after["x_1"] == pytest.approx(gone_on, abs=2e-4), "the structure keeps its motion"


def test_a_refused_change_changes_nothing() -> None:
    rig = Rig(config())
    rig.take_journal()
    with pytest.raises(ConfigError, match=r"barriers.gap_m must be > 0"):
        rig.configure({"barriers.gap_m": -0.002, "contact.law": "hertz"})
    assert rig.config == config()
    assert rig.take_journal() == []
    with pytest.raises(ConfigError, match="fixed at start"):
        rig.configure({"daq.block_scans": 7})


def test_publishing_options_change_no_sample_and_are_not_journaled(reference: list[Block]) -> None:
    rig = Rig(config())
    blocks = rig.advance(20 * TICK)
    rig.take_journal()
    rig.configure({"output.truth_scan": True, "output.monitor_rate_hz": 50.0, "time.ack_window": 3})
    assert rig.take_journal() == []
    more = rig.advance(60 * TICK)
    assert same(samples(blocks + more), samples(reference))
    assert more[5].truth is not None
    assert len(more[5].truth.rows) == 100
    assert sum(len(block.monitor) for block in more[-20:]) == 10


def test_a_seed_is_taken_at_the_next_reset() -> None:
    rig, other = Rig(config()), Rig(config(daq__seed=5))
    rig.configure({"daq.seed": 5})
    rig.reset()
    assert same(samples(rig.advance(rig.start_ns + 5 * TICK)), samples(other.advance(5 * TICK)))


# Reset, pluck, stop


def test_a_reset_begins_as_new_with_later_stamps(reference: list[Block]) -> None:
    rig = Rig(config(), START_NS)
    rig.advance(START_NS + 17 * TICK)
    rig.command(frequency_hz=20.0, current_a=1.0)
    rig.advance(START_NS + 23 * TICK)
    rig.reset()
    assert rig.start_ns == START_NS + 23 * TICK
    blocks = rig.advance(rig.start_ns + 60 * TICK)
    assert blocks[0].scan.stamp_ns == START_NS + 23 * TICK
    assert (blocks[0].number, blocks[0].first_sample) == (0, 0)
    assert same(samples(blocks), samples(reference))
    assert same(impacts(blocks), impacts(reference))


def test_a_pluck_locks_the_base_and_lets_the_structure_ring_at_its_natural_frequency() -> None:
    rig = Rig(config(sphere__present=False, output__truth_scan=True))
    rig.advance(10 * TICK)
    rig.pluck(0.002)
    blocks = rig.advance(210 * TICK)
    truth = np.concatenate([block.truth.rows for block in blocks])
    assert np.all(truth["x_b"] == 0)
    assert truth["x_1"][0] == pytest.approx(0.002)
    crossings = np.flatnonzero(np.diff(np.signbit(truth["x_1"])))
    assert len(crossings) / 2 / 2.0 == pytest.approx(9.105, abs=0.3)
    zeta, cycles = 0.0044974, 18
    peaks = [np.abs(truth["x_1"][k * 1098 : (k + 1) * 1098]).max() for k in (0, cycles)]
    assert math.log(peaks[0] / peaks[1]) == pytest.approx(2 * math.pi * zeta * cycles, rel=0.05)
    with pytest.raises(CommandError, match="reset"):
        rig.command(current_a=0.5)
    rig.reset()
    rig.command(current_a=0.5)


def test_the_emergency_stop_ramps_and_latches() -> None:
    rig = Rig(config(instruments__ideal=True))
    rig.advance(30 * TICK)
    rig.stop()
    current = samples(rig.advance(60 * TICK))["current"]
    assert np.abs(current[:500]).max() > 0.2, "a ramp, not a cut"
    assert np.abs(current[1000:]).max() == 0, "zero after shaker.ramp_s"
    for refused in ({"current_a": 0.1}, {"frequency_hz": 9.0}):
        with pytest.raises(CommandError, match="clear_trip"):
            rig.command(**refused)
    with pytest.raises(CommandError, match="clear_trip"):
        rig.reset()
    rig.clear_trip()
    assert rig.amplitude == 0
    rig.command(current_a=0.1)


def travel(blocks: list[Block]) -> np.ndarray:
    return np.concatenate([block.truth.rows["x_b"] for block in blocks])


@pytest.mark.parametrize("step", [1, 7, 200])
def test_over_travel_trips_within_a_tick_whatever_the_cut(step: int) -> None:
    """5 A at 8 Hz drive the table far beyond 2 mm."""
    chosen = config(
        drive__amplitude=5.0, drive__frequency_hz=8.0, shaker__travel_limit_m=0.002, output__truth_scan=True
    )
    rig, blocks = Rig(chosen), []
    while len(blocks) < 200:
        blocks += rig.advance((len(blocks) + step) * TICK)
    entries = read(rig.take_journal())
    (trip,) = [entry for entry in entries if entry.kind is Kind.TRIP]
    first = int(np.argmax(np.abs(travel(blocks)) > 0.002))
    assert trip.key == "over_travel"
    assert first < trip.sample <= first + 100, "at the end of the tick in which the limit was exceeded"
    assert trip.value > 0.002
    assert rig.latched is not None
    assert rig.latched.startswith("over_travel")
    assert "0.002" in rig.latched
    again = list(zip(resimulate([Table(0, table.rows) for table in retake(chosen, 200)]), blocks, strict=False))
    assert all(same(one.scan.rows, two.scan.rows) for one, two in again)


def retake(chosen: RigConfig, blocks: int) -> list[Table]:
    rig = Rig(chosen)
    rig.advance(blocks * TICK)
    return rig.take_journal()


def test_over_current_trips_on_the_rms_of_the_true_current() -> None:
    """A voltage drive does not command the current: here it is far above the limit."""
    rig = Rig(config(drive__kind="voltage", drive__amplitude=2.0, shaker__current_limit_a_rms=2.0))
    rig.configure({"shaker.current_limit_a_rms": 0.1, "shaker.travel_limit_m": 1.0})
    rig.advance(300 * TICK)
    assert rig.latched is not None
    assert rig.latched.startswith("over_current")


def test_the_drive_ramps_down_when_the_controller_dies() -> None:
    rig = Rig(config(output__command_timeout_s=0.2, instruments__ideal=True))
    rig.advance(15 * TICK)
    rig.command(current_a=0.52)
    current = samples(rig.advance(60 * TICK))["current"]
    at = [entry.sample for entry in read(rig.take_journal()) if entry.kind is Kind.TIMEOUT]
    assert at == [3500]
    assert np.abs(current[3500 + 1000 - 1500 :]).max() == 0
    rig.command(current_a=0.1)
    assert rig.amplitude == 0.1


# Journal


def eventful(chosen: RigConfig, cuts: int) -> tuple[list[Block], list[Table], Rig]:
    """A run with every kind of input; `cuts` advances between two of them."""
    rig, blocks = Rig(chosen, START_NS), []

    def go(ticks: int) -> None:
        end = rig.start_ns + ticks * TICK
        for k in range(1, cuts + 1):
            blocks.extend(rig.advance(rig.frontier_ns + (end - rig.frontier_ns) * k // cuts))

    go(13)
    rig.command(current_a=0.4)
    rig.command(frequency_hz=9.05, current_a=0.45)
    go(29)
    rig.configure({"barriers.gap_m": 0.003, "contact.law": "lankarani_nikravesh", "contact.restitution": 0.5})
    rig.configure({"instruments.laser.lag_s": 1e-3})
    rig.inject(Fault(kind="offset_step", channel="laser", start=4000, duration=300, value=1e-3, seed=7))
    go(37)
    rig.command(frequency_hz=12.0)
    go(50)
    rig.stop()
    go(55)
    rig.clear_trip()
    rig.command(current_a=0.52)
    rig.clear_fault()
    go(70)
    rig.pluck(0.001)
    go(80)
    return blocks, rig.take_journal(), rig


@pytest.mark.parametrize("cuts", [1, 5])
def test_the_journal_is_all_a_resimulation_needs(cuts: int) -> None:
    blocks, journal, _ = eventful(config(daq__block_scans=250, daq__seed=9), cuts)
    again = [block for block, _ in zip(resimulate(journal), blocks, strict=False)]
    assert len(blocks) > 30
    for one, two in zip(again, blocks, strict=True):
        assert one.scan.stamp_ns == two.scan.stamp_ns
        assert same(one.scan.rows, two.scan.rows), f"block {two.number}"
    assert same(impacts(again), impacts(blocks))


def test_a_resimulation_begins_at_the_last_reset() -> None:
    _, _, rig = eventful(config(), 2)
    rig.reset()
    blocks = rig.advance(rig.start_ns + 10 * TICK)
    rig.command(current_a=0.3)
    blocks += rig.advance(rig.start_ns + 20 * TICK)
    again = [block for block, _ in zip(resimulate(rig.take_journal()), blocks, strict=False)]
    assert all(same(one.scan.rows, two.scan.rows) for one, two in zip(again, blocks, strict=True))
    assert again[0].scan.stamp_ns == blocks[0].scan.stamp_ns


def test_a_journal_with_a_missing_row_is_refused() -> None:
    _, journal, _ = eventful(config(), 1)
    with pytest.raises(ConfigError, match=r"row 3 is missing"):
        read([journal[0], *journal[2:]])
    with pytest.raises(ConfigError, match="empty"):
        read([])


def test_journal_rows_carry_every_kind_of_value_exactly() -> None:
    changes = {
        "barriers.gap_m": 0.1 + 0.2,
        "daq.seed": 2**53,
        "sphere.present": False,
        "contact.law": "lankarani_nikravesh",
        "instruments.faults.planned": ("stuck channel=laser start_s=1 duration_s=0.5", "lost_block start_s=2.5 seed=3"),
    }
    rig = Rig(from_flat(RigConfig(), changes))
    initial = [entry for entry in read(rig.take_journal()) if entry.kind is Kind.INITIAL]
    assert values_of(initial) == changes


def test_short_keys_of_configuration_values_are_unique() -> None:
    names = list(to_flat(RigConfig()))
    assert len({short_key(name) for name in names}) == len(names)
    assert all(len(short_key(name).encode()) <= 32 for name in names)


def test_a_lost_block_is_numbered_and_marked() -> None:
    planned = ("lost_block start_s=0.03 duration_s=0.02",)
    blocks = Rig(config(instruments__faults__planned=planned)).advance(10 * TICK)
    assert [block.number for block in blocks if block.lost] == [3, 4]
    assert len(blocks) == 10
    states = [(row["kind"], row["active"]) for block in blocks if block.faults is not None for row in block.faults.rows]
    assert states == [(b"lost_block", 1), (b"lost_block", 0)]


def test_monitor_instants_are_scans_at_the_asked_rate() -> None:
    blocks = Rig(config(daq__rate_hz=25_600, daq__block_scans=256, output__monitor_rate_hz=200.0)).advance(NS_PER_S)
    indices = np.concatenate([block.first_sample + block.monitor_scans for block in blocks])
    assert np.array_equal(indices, np.arange(200) * 128)
    for block in blocks:
        assert np.array_equal(block.monitor["time"], block.monitor_scans / 25_600)


def test_memory_stays_bounded() -> None:
    """What is handed out is forgotten: nothing in the rig grows with its running time."""
    rig = Rig(config())
    rig.advance(100 * TICK)
    kept = [len(part) for part in (rig._truth._states, rig._truth._impacts)]
    rig.advance(400 * TICK)
    assert [len(part) for part in (rig._truth._states, rig._truth._impacts)] <= [max(k, 1) for k in kept]


def test_blocks_are_values_of_their_own() -> None:
    """A later advance must not write into a block that was handed out."""
    rig = Rig(config())
    (block,) = rig.advance(TICK)
    before = attrs.evolve(block), block.scan.rows.copy(), block.monitor.copy()
    rig.advance(20 * TICK)
    assert same(block.scan.rows, before[1])
    assert same(block.monitor, before[2])
    assert stamp_ns(0, 10_000) == block.scan.stamp_ns
