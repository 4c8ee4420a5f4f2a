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
"""Output and acquisition of a rig: each alone, in threads, in processes, and used like DAQ libraries."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from impact_rig.blocks import Table
from impact_rig.driver import Acquisition, AnalogOutput, Hardware, LocalRig, RigDriver, UnderrunError
from impact_rig.driver.hardware import Exchange
from impact_rig.errors import CommandError, ConfigError
from impact_rig.instruments.fault import Fault
from impact_rig.rig.journal import InputKind

RATE_HZ, BLOCK = 2000, 100
LINEAR = {"sphere.present": False, "instruments.ideal": True, "daq.rate_hz": RATE_HZ, "daq.block_scans": BLOCK}
STREAM = {**LINEAR, "drive.waveform": "stream", "drive.stream_rate_hz": RATE_HZ}
ONWARD = {**STREAM, "drive.stream_wait": False}
WAVE = 0.3 * np.sin(2.0 * np.pi * 9.0 * np.arange(RATE_HZ) / RATE_HZ)
PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "drive.md"


def current(rows: np.ndarray) -> np.ndarray:
    return np.asarray(rows["current"], np.float64)


def test_samples_and_scans_of_different_rates_cannot_be_exchanged() -> None:
    hardware = Hardware(LocalRig({**STREAM, "drive.stream_rate_hz": 10_000}))
    for exchange in (lambda: hardware.respond(WAVE), lambda: Exchange(hardware, 100)):
        with pytest.raises(ConfigError, match=r"drive.stream_rate_hz = 10000 Hz and daq.rate_hz = 2000 Hz"):
            exchange()


@pytest.mark.parametrize("lag", [0, -1])
def test_an_exchange_needs_a_lag(lag: int) -> None:
    with pytest.raises(ConfigError, match=f"lag of an Exchange must be at least 1 sample, got {lag}"):
        Exchange(Hardware(LocalRig(STREAM)), lag)


# Each row of the page's table, by its first column


def channels_and_clock() -> None:
    rig = LocalRig(STREAM)
    assert (rig.stream_rate_hz, rig.rate_hz) == (RATE_HZ, RATE_HZ)
    assert set(rig.rows("daq/scan").dtype.names or ()) >= {"time", "accelerometer", "laser", "base", "current"}


def write_before_start() -> None:
    rig = LocalRig(STREAM)
    output, acquisition = AnalogOutput(rig), Acquisition(rig)
    output.write(WAVE[:500])
    assert (output.buffered, output.next_sample) == (500, None)
    acquisition.start(output.start())
    output.write(WAVE[500:])
    output.stop()
    assert np.abs(current(acquisition.read(RATE_HZ)) - WAVE).max() < 1e-9


def nothing_is_played_twice() -> None:
    rig = LocalRig(STREAM)
    output, acquisition = AnalogOutput(rig), Acquisition(rig)
    acquisition.start(output.start())
    output.write(np.full(500, 0.2))
    output.stop()
    assert np.abs(current(acquisition.read(4 * RATE_HZ))[RATE_HZ:]).max() < 1e-9


def space_in_the_buffer() -> None:
    output = AnalogOutput(LocalRig(STREAM))
    output.start()
    before = output.space
    output.write(WAVE[:300])
    assert (output.buffered, output.space) == (300, before - 300)
    assert output.ready(before - 300)
    assert not output.ready(before - 299)


def size_of_the_buffer() -> None:
    rig = LocalRig(STREAM)
    output = AnalogOutput(rig, buffer_s=0.2)
    output.start()
    output.write(WAVE)
    assert output.buffered <= 0.2 * RATE_HZ
    assert rig.sample >= RATE_HZ - 0.2 * RATE_HZ - BLOCK
    for wrong in (0.09, 3.0, float("nan")):
        with pytest.raises(ConfigError, match=r"buffer_s must be from 0\.1 \(two blocks\) to 2\.0005 s"):
            AnalogOutput(rig, buffer_s=wrong)


def underrun_raises() -> None:
    rig = LocalRig(ONWARD)
    output = AnalogOutput(rig)
    output.start()
    output.write(WAVE[:250])
    rig.step(5)
    with pytest.raises(UnderrunError, match=r"underrun: 251 samples were not written in time") as caught:
        output.write(WAVE[:100])
    assert caught.value.samples == 251  # the value at the end of the last block is sample 500
    assert [entry.text for entry in rig.journal() if entry.kind is InputKind.STREAM][-1] == "underrun"
    assert output.start() == 501
    assert output.write(WAVE[:100]) == 0


def underrun_is_returned() -> None:
    rig = LocalRig(ONWARD)
    output = AnalogOutput(rig, raise_underrun=False)
    output.start()
    assert output.write(WAVE[:250]) == 0
    rig.step(5)
    assert (output.late, output.missing) == (0, 251)
    assert output.write(WAVE[:100]) == 251
    assert (output.write(WAVE[:100]), output.next_sample) == (0, 701)


def start_trigger() -> None:
    rig = LocalRig(STREAM)
    output, acquisition = AnalogOutput(rig), Acquisition(rig)
    first = output.start(lead_s=0.1)
    acquisition.start(first)
    output.write(WAVE)
    output.stop()
    assert np.abs(current(acquisition.read(RATE_HZ)) - WAVE).max() < 1e-9
    assert acquisition.delay_s(first, first) == 0.0
    assert acquisition.delay_s(first, first + 1) == 1.0 / RATE_HZ


def scans_available() -> None:
    rig = LocalRig(LINEAR)
    acquisition = Acquisition(rig)
    acquisition.start()
    rig.step(3)
    assert acquisition.available == 3 * BLOCK
    assert len(acquisition.read_remaining()) == 3 * BLOCK
    assert acquisition.available == 0


def read_scans() -> None:
    rig = LocalRig(LINEAR)
    acquisition = Acquisition(rig)
    rows = np.concatenate([acquisition.read(count) for count in (1, 99, 250, 7)])
    twin = LocalRig(LINEAR)
    twin.step(4)
    assert rows["laser"].tobytes() == twin.rows()["laser"][:357].tobytes()


def scans_overwritten() -> None:
    rig = LocalRig(LINEAR, [Fault(kind="lost_block", start_sample=150, samples=50)])
    acquisition = Acquisition(rig, buffer_s=0.25)
    acquisition.start()
    rig.step(3)
    assert (acquisition.lost, acquisition.available) == (BLOCK, 3 * BLOCK)
    rig.step(10)
    assert acquisition.available == 500
    assert acquisition.lost == 8 * BLOCK
    assert len(acquisition.read(500)) == 500
    assert acquisition.next_scan == 13 * BLOCK


def stop_and_clear() -> None:
    rig = LocalRig(STREAM)
    output, acquisition = AnalogOutput(rig), Acquisition(rig)
    acquisition.start(output.start())
    output.write(WAVE[:500])
    output.stop()
    assert [entry.name for entry in rig.journal() if entry.kind is InputKind.STREAM] == []
    acquisition.read(RATE_HZ)
    acquisition.stop()
    rig.step(10)
    assert acquisition.read_remaining().size == 0
    assert [entry.text for entry in rig.journal() if entry.kind is InputKind.STREAM][-1] == "ended"


ROWS: dict[str, Callable[[], None]] = {
    "create channels, configure the sample clock": channels_and_clock,
    "write before start": write_before_start,
    "buffered analog output, regeneration off": nothing_is_played_twice,
    "space available in the buffer": space_in_the_buffer,
    "configure the output buffer": size_of_the_buffer,
    "underrun error": underrun_raises,
    "continue after an underrun": underrun_is_returned,
    "start trigger, delay between output and input": start_trigger,
    "samples available per channel": scans_available,
    "read N samples per channel": read_scans,
    "samples overwritten before they were read": scans_overwritten,
    "stop, clear task": stop_and_clear,
}


@pytest.mark.parametrize("row", ROWS)
def test_each_row_of_the_vocabulary_is_true(row: str) -> None:
    ROWS[row]()


def test_the_page_lists_the_tested_rows() -> None:
    lines = PAGE.read_text(encoding="utf-8").split("| in a DAQ library | here |\n| --- | --- |\n")[1].splitlines()
    table = [line.split("|")[1].strip() for line in lines[: lines.index("")]]
    assert table == list(ROWS)


def test_samples_that_exceed_the_buffer_before_the_start_are_rejected() -> None:
    output = AnalogOutput(LocalRig(STREAM), buffer_s=0.2)
    output.write(WAVE[:300])
    with pytest.raises(CommandError, match="200 samples before the start do not fit: the buffer has room for 100"):
        output.write(WAVE[:200])


def test_a_second_start_plays_after_the_samples_of_the_first() -> None:
    output = AnalogOutput(LocalRig(STREAM))
    for first in (0, 300):
        assert output.start() == first
        output.write(WAVE[:300])
        output.stop()


@pytest.mark.heavy
def test_an_output_without_an_input_keeps_no_scans() -> None:
    rig = LocalRig(STREAM)
    output = AnalogOutput(rig, buffer_s=0.2)
    output.start()
    for _ in range(5):
        output.write(WAVE)
    assert rig.tables() == []


@pytest.fixture(params=["local", pytest.param("ros", marks=pytest.mark.ros)])
def shared(request: pytest.FixtureRequest) -> Iterator[RigDriver]:
    """Rig that two threads share, in this process or in real time over topics."""
    if request.param == "local":
        yield LocalRig(STREAM)
        return
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.driver import RosRig

    with RosRig(STREAM, mode="realtime", hosted=True) as rig:
        yield rig


def test_two_threads_share_a_rig(shared: RigDriver) -> None:
    output, acquisition = AnalogOutput(shared), Acquisition(shared)
    output.write(WAVE[: RATE_HZ // 2])
    acquisition.start(output.start())

    def play() -> None:
        for _ in range(3):
            output.write(WAVE)
        output.stop()

    thread = threading.Thread(target=play)
    thread.start()
    read = current(np.concatenate([acquisition.read(500) for _ in range(14)]))
    thread.join()
    expected = np.concatenate([WAVE[: RATE_HZ // 2], WAVE, WAVE, WAVE])
    assert (output.late, output.missing, acquisition.lost) == (0, 0, 0)
    assert np.abs(read - expected).max() < 1e-9


PLAYER = """
import sys, numpy as np
from impact_rig.driver import AnalogOutput, RosRig
with RosRig(namespace="/rig") as rig:
    output = AnalogOutput(rig, buffer_s=1.0)
    output.write(np.full(1000, 0.2))
    print(output.start(), flush=True)
    for _ in range(3):
        output.write(np.full(1000, 0.2))
    while output.buffered:
        rig.step()
    print(output.late, output.missing, len(rig.tables()), flush=True)
    output.stop()
"""


@pytest.mark.ros
def test_input_and_output_work_in_separate_processes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.client.processes import Processes, isolated_domain
    from impact_rig.driver import RosRig

    with isolated_domain() as domain_id, Processes(domain_id, tmp_path / "logs", "/rig") as processes:
        processes.start("rig", STREAM)
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
        with RosRig(namespace="/rig") as rig:
            acquisition = Acquisition(rig)
            player = subprocess.Popen([sys.executable, "-c", PLAYER], stdout=subprocess.PIPE, text=True)
            assert player.stdout is not None
            acquisition.start(int(player.stdout.readline()))
            rows = acquisition.read(3500, timeout_s=30.0)
            words = player.communicate(timeout=60)[0].split()
    assert words[0] == "0"
    assert words[2] in {"0", "1"}
    assert np.abs(current(rows) - 0.2).max() < 1e-9
    assert acquisition.lost == 0


@pytest.mark.ros
def test_the_state_of_an_output_is_current_without_other_calls() -> None:
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.driver import RosRig

    with RosRig(STREAM, mode="realtime", hosted=True) as rig:
        output = AnalogOutput(rig, raise_underrun=False)
        output.start()
        output.write(WAVE)
        assert not output.ready(output._size)
        while not output.ready(output._size):
            pass
        while output.missing < RATE_HZ // 10:
            pass
        assert output.buffered == 0
        assert output.write(WAVE) >= RATE_HZ // 10


@pytest.mark.parametrize("count", [300, 250, 3000], ids=["whole", "within a block", "more than the buffer"])
def test_any_number_of_scans_can_be_read_at_once(count: int) -> None:
    rig = LocalRig(LINEAR)
    acquisition = Acquisition(rig, buffer_s=min(count, 300) / RATE_HZ)

    def check(_table: Table) -> None:
        assert rig.sample <= count + BLOCK, "the read should have returned"

    rig.connect(check)
    assert len(acquisition.read(count)) == count
    assert acquisition.lost == 0


class Backlog(LocalRig):
    """Rig that runs by itself, of which several blocks arrive at once."""

    runs_by_itself = True

    def poll(self) -> None:
        self.step(5)


def test_no_scan_is_lost_while_a_read_waits() -> None:
    acquisition = Acquisition(Backlog(LINEAR), buffer_s=3 * BLOCK / RATE_HZ)
    acquisition.start(0)
    assert len(acquisition.read(6 * BLOCK)) == 6 * BLOCK
    assert acquisition.lost == 2 * BLOCK  # those of five blocks that arrived before the wait
    assert acquisition.available == 3 * BLOCK  # the buffer keeps its size


def test_a_program_that_plays_by_what_it_reads_is_not_held_up_by_withheld_scans() -> None:
    """It writes the next samples after it has read, so no further block would show that scans are missing."""
    rig = LocalRig(STREAM, [Fault(kind="lost_block", start_sample=5 * BLOCK, samples=BLOCK)])
    hardware = Hardware(rig)
    exchange = Exchange(hardware, BLOCK)
    counts = [len(exchange.exchange(np.zeros(BLOCK))[1]) for _ in range(8)]
    assert sorted(counts) == [0] + [BLOCK] * 7
    assert hardware.acquisition.lost == BLOCK


@pytest.mark.parametrize("withheld", [1, 5])
def test_withheld_scans_need_no_room_in_the_buffer(withheld: int) -> None:
    """A gap longer than the buffer, after everything was read, must not drop the block behind it."""
    rig = LocalRig(LINEAR, [Fault(kind="lost_block", start_sample=2 * BLOCK, samples=withheld * BLOCK)])
    acquisition = Acquisition(rig, buffer_s=BLOCK / RATE_HZ)
    acquisition.start(0)
    rig.step(1)
    assert len(acquisition.read(BLOCK)) == BLOCK
    rig.step(1)
    assert len(acquisition.read(BLOCK)) == BLOCK
    rig.step(withheld + 1)
    assert (acquisition.next_scan, acquisition.lost) == ((2 + withheld) * BLOCK, withheld * BLOCK)
    assert len(acquisition.read(BLOCK)) == BLOCK


def test_new_rates_of_a_stream_count_from_the_next_reset() -> None:
    rig = LocalRig({**STREAM, "drive.stream_wait": False})
    rig.configure({"drive.stream_rate_hz": 4000})
    assert rig.stream_rate_hz == RATE_HZ
    rig.reset()
    assert rig.stream_rate_hz == 4000
    rig.configure({"drive.waveform": "sine"})
    rig.reset()
    assert rig.stream_rate_hz == 4000


def test_a_reading_beyond_its_limit_ends_the_test() -> None:
    hardware = Hardware(LocalRig(STREAM), {"current": 0.1})
    with pytest.raises(CommandError, match=r"aborted: current reads .*, beyond the limit ±0\.1 A, at scan"):
        hardware.respond(WAVE)


class Standing(LocalRig):
    """Rig with a sine as its drive whose time stands still, as that of a paused rig."""

    def step(self, blocks: int = 1, timeout_s: float = 0.0) -> None:
        raise TimeoutError("no block arrived")


def test_a_rig_without_a_stream_that_stands_still_is_reported_as_a_timeout() -> None:
    with pytest.raises(TimeoutError, match=r"^timeout: waiting for 1 scans; check that the rig advances$"):
        Acquisition(Standing(LINEAR)).read(1, timeout_s=0.0)
