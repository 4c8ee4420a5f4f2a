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
"""Fuzz targets for texts and numbers: configuration files, parameters, commands, remarks, fault lines."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from hypothesis import strategies as st

from fuzz.mutation import HOSTILE_WORDS, mutated_lines
from fuzz.target import Target
from impact_rig.analysis.settings import ImpactSettings, TrackerSettings, parse_label, read_settings
from impact_rig.blocks import SETTINGS, Table
from impact_rig.errors import ImpactRigError
from impact_rig.instruments.fault import Fault
from impact_rig.instruments.instrument import FAULT_KINDS
from impact_rig.recording.description import schema_text
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, dump, fields, from_flat, load_config, to_flat
from impact_rig.rig.journal import JournalEntry, last_journal
from impact_rig.system.files import config_dir

KNOWN = {name: about for name, about, _ in fields()}
ANY_NUMBER = st.floats() | st.sampled_from((0.0, -0.0, 1e-320, 1e308, -1.0, 1e-9, 0.5, 2.0, 100.0))
ANY_VALUE = (
    ANY_NUMBER
    | st.integers(-(2**70), 2**70)
    | st.booleans()
    | st.none()
    | st.sampled_from(HOSTILE_WORDS)
    | st.lists(st.sampled_from(HOSTILE_WORDS) | ANY_NUMBER, max_size=3)
)
NAMES = st.sampled_from(sorted(KNOWN))
CHANGES = st.dictionaries(NAMES | st.text(max_size=20) | NAMES.map(lambda name: name + "x"), ANY_VALUE, max_size=3)


def _check_config(config: RigConfig) -> None:
    """Check that every value is within its declared range, and that the configuration can be written and read again."""
    for name, value in to_flat(config).items():
        about = KNOWN[name]
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            assert math.isfinite(value), name
            assert about.low is None or value >= about.low, name
            assert about.high is None or value <= about.high, name
        assert not about.choices or value in about.choices, name


def configuration_file(text: str | bytes) -> None:
    """Check that a file gives a configuration that can be written and read again, or is rejected."""
    with tempfile.TemporaryDirectory(prefix="impact_rig_fuzz_") as folder:
        path = Path(folder, "rig.yaml")
        path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass"))
        config = load_config(path)
        _check_config(config)
        if config != RigConfig():
            path.write_text(dump(config), encoding="utf-8")
            assert load_config(path) == config


def parameters(changes: dict[str, Any]) -> None:
    """Check that all changes are made, or none."""
    config = from_flat(RigConfig(), changes)
    _check_config(config)
    flat = to_flat(config)
    for name, value in changes.items():
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            assert flat[name] in (value, str(value)), name  # a name may consist of digits


@st.composite
def _settings(draw: st.DrawFn) -> dict[str, Any]:
    section = draw(st.sampled_from((TrackerSettings, ImpactSettings)))
    names = st.sampled_from([attribute.name for attribute in attrs.fields(section)])
    return {"section": section, "values": draw(st.dictionaries(names, ANY_VALUE, min_size=1, max_size=3))}


def settings(given: dict[str, Any]) -> None:
    """Check settings of the analysis: from parameters, and as read back from a recorded table."""
    section, values = given["section"], given["values"]
    numbers = {key: value for key, value in values.items() if isinstance(value, float)}
    if numbers and section is TrackerSettings:
        read_settings(Table(0, np.array(list(numbers.items()), SETTINGS)))
    made = section(**values)
    for attribute in attrs.fields(section):
        assert math.isfinite(getattr(made, attribute.name))


LINES = st.lists(
    st.sampled_from((*FAULT_KINDS, "channel=laser", "start_s=1", "value=nan", "seed=-1", "rate_hz=1e999", "=", "x=y"))
    | st.sampled_from(("gap_m=", "0.004", " at ", "12", "1e9", "-1", "nan", "9" * 30))
    | st.sampled_from(("sensor_msgs/msg/", "PointCloud2", "../", "/etc/passwd", "std_msgs/", "Header"))
    | st.text(max_size=8),
    max_size=6,
)


def texts(words: list[str]) -> tuple[int, int]:
    """Check remarks, fault lines, journal entries and type names, all of which come from the network or a file."""
    label = parse_label("".join(words))
    if label is not None:
        assert math.isnan(label.gap_m) or 0 <= label.gap_m <= 1
        assert parse_label(label.text()) == label or math.isnan(label.gap_m)
    refused = 0
    for attempt in (
        lambda: Fault.from_line(" ".join(words), 1000),
        lambda: JournalEntry.from_line(" ".join(words)),
        lambda: schema_text("".join(words)),
    ):
        try:
            attempt()
        except ImpactRigError:
            refused += 1
    return 3, refused


OPERATIONS = st.one_of(
    st.tuples(st.just("accept"), ANY_NUMBER | st.none(), ANY_NUMBER | st.none()),
    st.tuples(st.just("accept"), st.floats(5, 200), st.floats(0, 1)),
    st.tuples(st.just("configure"), CHANGES),
    st.tuples(st.just("pluck"), ANY_NUMBER | st.floats(-0.006, 0.006)),
    st.tuples(
        st.just("fault"),
        st.sampled_from((*FAULT_KINDS, "none")),
        st.sampled_from(("laser", "base", "current", "accelerometer", "", "x")),
        st.integers(-1, 3000),
        ANY_NUMBER,
    ),
    st.tuples(st.just("clear_fault"), st.integers(-1, 4) | st.none()),
    st.sampled_from((("stop",), ("clear_trip",), ("reset",))),
    st.tuples(st.just("advance"), st.integers(1, 3)),
)


def commands(operations: list[tuple[Any, ...]]) -> tuple[int, int]:
    """Check that every request to a rig is executed or rejected, its scans are numbers, its journal complete."""
    refused = 0
    rig = Rig(from_flat(RigConfig(), {"daq.rate_hz": 2000, "daq.block_scans": 20, "barriers.gap_m": 0.002}))
    for name, *arguments in operations:
        try:
            if name == "advance":
                _advance(rig, *arguments)
            elif name == "fault":
                kind, channel, start, value = arguments
                rig.inject(Fault(kind=kind, channel=channel, start_sample=start, value=value))
            else:
                getattr(rig, name)(*arguments)
        except ImpactRigError:
            refused += 1
    _advance(rig, 2)
    assert last_journal(rig.take_journal())
    return len(operations), refused


def _advance(rig: Rig, blocks: int) -> None:
    for block in rig.advance(rig.block_end_ns(blocks)):
        for name in block.scan.rows.dtype.names or ():
            assert np.isfinite(block.scan.rows[name]).all(), f"{name} is not finite"


NOMINAL = (config_dir() / "nominal.yaml").read_text(encoding="utf-8")
TARGETS = (
    Target(
        "configuration_file",
        mutated_lines(NOMINAL) | mutated_lines(dump(RigConfig())) | st.binary(max_size=100) | st.text(max_size=100),
        configuration_file,
        (
            "impact_rig/config/tree.py",
            "impact_rig/config/fields.py",
            "impact_rig/rig/config.py",
            "impact_rig/config/sections.py",
        ),
    ),
    Target("parameters", CHANGES, parameters, ("impact_rig/config/tree.py", "impact_rig/config/fields.py")),
    Target("settings", _settings(), settings, ("impact_rig/analysis/settings.py",)),
    Target(
        "texts",
        LINES,
        texts,
        ("impact_rig/analysis/settings.py", "impact_rig/instruments/fault.py", "impact_rig/recording/description.py"),
    ),
    Target(
        "commands",
        st.lists(OPERATIONS, max_size=12),
        commands,
        ("impact_rig/rig/core.py", "impact_rig/rig/interlock.py", "impact_rig/rig/journal.py"),
    ),
)
