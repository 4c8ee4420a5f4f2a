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
"""Short part of `make fuzz`, and its past findings: inputs that must not be accepted, or end in a traceback."""

from __future__ import annotations

import itertools
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))  # the targets are no part of the package

from fuzz import calls, decoders, importers, sockets, target, validators  # noqa: E402
from impact_rig import blocks  # noqa: E402
from impact_rig.analysis.settings import read_settings  # noqa: E402
from impact_rig.analysis.tracker import Tracker  # noqa: E402
from impact_rig.blocks import Table  # noqa: E402
from impact_rig.errors import ConfigError, RecordingError  # noqa: E402
from impact_rig.instruments.fault import Fault  # noqa: E402
from impact_rig.recording import TopicDescription, open_run  # noqa: E402
from impact_rig.rig import resimulate  # noqa: E402
from impact_rig.rig.config import load_config  # noqa: E402
from impact_rig.rig.journal import JournalEntry  # noqa: E402

TARGETS = (*decoders.TARGETS, *validators.TARGETS, *importers.TARGETS, *sockets.TARGETS, *calls.TARGETS)
SLICE = 30


@pytest.mark.parametrize("one", TARGETS, ids=lambda one: one.name)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.repeats
def test_a_sample_of_hostile_inputs_is_handled(one: target.Target) -> None:
    """The inputs are the same each time; `make fuzz` uses 10,000 per target."""
    tally = target.run(one, SLICE)
    assert tally.inputs >= SLICE
    assert tally.refused > 0, "hostile inputs are refused"
    for module in one.modules:
        assert (ROOT / module).is_file()


@pytest.mark.slow
def test_memory_of_hypothesis_does_not_count_for_the_inputs(tmp_path: Path) -> None:
    """The table that hypothesis makes at the first text in a fresh clone must not count as memory of a mapping."""
    command = [sys.executable, "-m", "fuzz", "--inputs", "20", "--seed", "20261128", "import_mapping"]
    environment = os.environ | {"HYPOTHESIS_STORAGE_DIRECTORY": str(tmp_path)}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert [*tmp_path.glob("unicode_data/*/codec*")], "some text was drawn"


# Past findings, each with its input


def journal_with(number: int, **members: object) -> list[JournalEntry]:
    lines = [entry.line() for entry in decoders.JOURNAL]
    lines[number] = json.dumps(json.loads(lines[number]) | members)
    return [JournalEntry.from_line(line) for line in lines]


@pytest.mark.parametrize(
    ("members", "words"),
    [
        ({"sample": math.nan}, "its member sample must be an integer"),
        ({"sample": -1}, "must be from 0 to 2"),
        ({"stamp_ns": 10**30}, "its member stamp_ns must be from 0 to 2"),
        ({"value": 10**400}, "value is an integer too large"),
        ({"kind": "parameter", "values": {"daq.seed": 5.5}}, "daq.seed must be an integer, got 5.5; only rigs write"),
        ({"kind": "parameter", "values": {"daq.sed": 5}}, "unknown configuration value 'daq.sed'"),
        ({"kind": "parameter", "values": {"sphere.start": [1]}}, "sphere.start must be a text"),
        ({"kind": "parameter", "values": {"instruments.faults.planned": [1]}}, r"must be a list of texts, got \[1\]"),
        ({"kind": "clear_fault", "value": math.nan}, "number of the fault to clear must be an integer, got nan"),
        ({"kind": "fault"}, "of kind fault needs a fault"),
        ({"kind": "fault", "fault": {"kind": "dropout", "channel": "laser", "seed": "x"}}, "seed of its fault"),
        (
            {"kind": "fault", "fault": {"kind": "stuck", "channel": "x"}},
            "an invalid instrument fault: stuck needs a channel",
        ),
        ({"kind": "pluck", "value": None}, "its member value must be a number, got None"),
        (
            {"kind": "command", "name": "phase", "value": 1.0},
            "entry 2, counted from 0, of the journal .*: a command must be for frequency or current, got 'phase'",
        ),
        ({"more": 1}, "unknown member 'more'"),
    ],
)
def test_an_invalid_journal_is_rejected_by_name(members: dict[str, object], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        list(itertools.islice(resimulate(journal_with(2, **members)), 5))


def test_a_line_that_is_nested_too_deeply_is_rejected() -> None:
    with pytest.raises(ConfigError, match="it is not valid JSON"):
        JournalEntry.from_line("[" * 100_000)


def test_a_journal_entry_far_in_the_future_costs_only_what_is_read() -> None:
    found = resimulate(journal_with(2, sample=2**50))
    assert [next(found).number for _ in range(150)] == list(range(150))


@pytest.mark.parametrize(
    ("topic", "rows", "words"),
    [
        ("configure", decoders.INFO.rows[["name", "rate"]], "daq/info lacks the column unit, range_low"),
        ("on_applied", decoders.APPLIED.rows[["time", "sample"]], "shaker/applied lacks the column frequency"),
        ("feed", decoders.SCANS[0].rows[["time"]], "daq/scan lacks the column accelerometer"),
        ("on_applied", np.full(1, np.nan, [(name, "f8") for name in blocks.APPLIED.names]), "time.* must be within"),
        ("on_applied", np.full(1, 1e305, [(name, "f8") for name in blocks.APPLIED.names]), "time.* must be within"),
    ],
)
def test_a_table_without_its_columns_is_rejected_by_name(topic: str, rows: np.ndarray, words: str) -> None:
    """The error must not be numpy's `no field of name ...`."""
    tracker = Tracker()
    if topic == "feed":  # which channels a record has is known from its calibration
        tracker.configure(decoders.INFO)
    with pytest.raises(ConfigError, match=words):
        getattr(tracker, topic)(Table(0, rows))


@pytest.mark.parametrize(
    ("column", "value", "words"),
    [
        ("rate", 1e12, "rate must be > 0 and <= 1e"),
        ("since_start", np.nan, "since_start, the time from scan 0 to the stamp, must be within .* got nan s; correct"),
        ("name", b"laser", "each once, and may list others, got"),
        ("noise", 1e200, "noise must be within ±1e"),
    ],
)
def test_an_invalid_calibration_is_rejected(column: str, value: object, words: str) -> None:
    rows = decoders.INFO.rows.copy()
    rows[column] = value
    with pytest.raises(ConfigError, match=words):
        Tracker().configure(Table(0, rows))


def test_scans_at_impossible_times_are_counted_as_lost() -> None:
    """A scan 3e8 years before its block must not raise an OverflowError."""
    tracker = Tracker()
    tracker.configure(decoders.INFO)
    rows = decoders.SCANS[0].rows.copy()
    rows["time"][0] = -(2.0**63) / 1000
    tracker.feed(Table(0, rows))
    assert tracker.counters.lost_scans == len(rows)


def test_a_command_with_a_frequency_near_zero_is_not_measured() -> None:
    """The period of 2.5e-65 Hz fits no integer; this must not raise an OverflowError."""
    tracker = Tracker()
    tracker.configure(decoders.INFO)
    applied = decoders.APPLIED.rows.copy()
    applied["frequency"] = 2.5e-65
    tracker.on_applied(Table(0, applied))
    found = [table.rows for scan in decoders.SCANS for table in tracker.feed(scan).measurements]
    assert all(rows["settled"][0] == 0 for rows in found)


@pytest.mark.parametrize("value", [np.nan, np.inf, 5.5, 1e300])
def test_invalid_recorded_settings_are_rejected(value: float) -> None:
    """NaN and infinity must not raise ValueError or OverflowError, and a fraction must not be cut off."""
    with pytest.raises(ConfigError, match="harmonics must be"):
        read_settings(Table(0, np.array([("harmonics", value)], blocks.SETTINGS)))


def test_an_empty_fault_line_is_rejected() -> None:
    with pytest.raises(ConfigError, match="fault kind must be one of"):
        Fault.from_line("", 1000)


@pytest.mark.parametrize(
    "text",
    [
        "a: &a\n  b: *a\n",
        "l0: &l0 {x: 1}\n" + "".join(f"l{n}: &l{n} {{x: *l{n - 1}, y: *l{n - 1}}}\n" for n in range(1, 19)),
        "l0: &l0 [1]\n" + "".join(f"l{n}: &l{n} [*l{n - 1}, *l{n - 1}]\n" for n in range(1, 40)),
    ],
)
def test_a_yaml_bomb_is_rejected_at_once(tmp_path: Path, text: str) -> None:
    """The first is nested too deeply; the others double with each line, wherever they are printed or copied."""
    (tmp_path / "rig.yaml").write_text(text)
    with pytest.raises(ConfigError, match=r"an alias .* is not accepted"):
        load_config(tmp_path / "rig.yaml")


@pytest.mark.parametrize("open_bracket", ["[", "{a: ", "- "])
def test_a_very_deeply_nested_yaml_text_is_rejected_without_a_crash(tmp_path: Path, open_bracket: str) -> None:
    (tmp_path / "rig.yaml").write_text(open_bracket * 200_000)
    with pytest.raises(ConfigError, match=r"nested deeper than|exceeded maximum nesting depth"):
        load_config(tmp_path / "rig.yaml")


@pytest.mark.parametrize("digits", ["9" * 400, "0x" + "f" * 5000])
def test_an_integer_beyond_the_range_of_floats_is_rejected_by_name(tmp_path: Path, digits: str) -> None:
    """The first must not raise an OverflowError, nor the second a ValueError, as Python does not write it out."""
    (tmp_path / "rig.yaml").write_text(f"daq:\n  seed: {digits}\n")
    with pytest.raises(ConfigError, match=r"seed must be .*, got a number too large to represent"):
        load_config(tmp_path / "rig.yaml")


@pytest.mark.parametrize("text", ["a: 2024-13-45", "&a [*a]", "[" * 1500, "a: &a {b: *a}"])
def test_invalid_yaml_inside_a_recording_is_handled(tmp_path: Path, text: str) -> None:
    """An invalid date must not raise a ValueError, nor deep nesting a RecursionError."""
    (tmp_path / "run.mcap").write_bytes(decoders.FILES[0])
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(RecordingError, match="cannot parse"):
        open_run(tmp_path)
    topic = TopicDescription(name="/a", type_name="a/msg/A", schema="", offered_qos_text=text)
    assert not any(isinstance(profile, dict) for profile in topic.offered_qos_yaml())
