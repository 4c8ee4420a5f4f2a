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
"""The runs whose bits are fixed, and the rows of them that are compared, for the command and the tests.

Each is a rig driven directly, without ROS. The short runs are for interpreters and emulated CPUs, which are slow.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import attrs
import numpy as np
from numpy.lib.recfunctions import repack_fields
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.blocks import Table
from impact_rig.instruments.section import channels_of, row_type_of
from impact_rig.physics import contact as contact_laws
from impact_rig.physics import outcome
from impact_rig.physics.contact import LAWS, ContactPair
from impact_rig.physics.contact.law import compiled_force
from impact_rig.physics.model import unit_parameters
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.journal import BEGINNINGS
from impact_rig.rig.monitors import AntiAlias
from impact_rig.rig.truth import monitor_step
from impact_rig.simtime import NS_PER_S

Streams = dict[str, NDArray[np.void]]
"""Rows by topic, in their order."""

MONITOR, MONITOR_HZ = "output.monitor_rate_hz", 100.0
"""Rate at which truth and readings are kept for their digests, fixed because the rig's default may change."""
MONITORS = "monitors"  # topic name for the readings of all channels at that rate
BLOCK = "daq.block_scans"
PAPER = {"drive.amplitude": 0.52}
FAULTS = (
    "spike_train channel=accelerometer start_s=1 duration_s=2 value=50 rate_hz=200 seed=7",
    "added_noise channel=laser start_s=2 duration_s=3 value=1e-4 seed=8",
    "clock_drift start_s=3 duration_s=2 value=40",
)
SHORT_FAULTS = (
    "spike_train channel=accelerometer duration_s=0.1 value=50 rate_hz=500 seed=7",
    "added_noise channel=laser start_s=0.02 value=1e-4 seed=8",
    "gain_error channel=base start_s=0.05 value=0.01",
    "stuck channel=current start_s=0.1 duration_s=0.02",
    "saturation channel=laser start_s=0.12 value=1e-4",
    "dropout channel=accelerometer start_s=0.15 duration_s=0.01",
)
HARD = {"drive.kind": "prescribed", "drive.amplitude": 0.003, "barriers.gap_m": 0.002, "output.truth_scan": True}
"""A base with prescribed motion hits the sphere within the first cycle."""


@attrs.frozen
class Run:
    """One fixed run."""

    name: str  # name in the file of digests
    seconds: float  # duration in rig time
    values: Mapping[str, object]  # differences from the default configuration
    commands: Mapping[float, tuple[float, float]] = attrs.field(factory=dict)
    """(Frequency [Hz], amplitude) by the second at which they are commanded."""
    # returns everything that its topics would have carried
    record: Callable[[Run], Streams] = attrs.field(default=lambda run: _rig(run))  # noqa: PLW0108  # it stands below


LONG = (
    Run("chirp", 20, {"drive.kind": "prescribed", "drive.waveform": "chirp", "drive.amplitude": 5e-4}),
    Run("default", 20, {**PAPER, "output.truth_scan": True}, {10.0: (9.3, 0.6)}),
    Run("friction", 20, {**PAPER, "sphere.guide_friction": 0.1}),
    Run("gap_2mm", 20, {**PAPER, "barriers.gap_m": 0.002}),
    Run("gap_8mm", 120, {**PAPER, "barriers.gap_m": 0.008, "daq.rate_hz": 1000}),  # chaotic: one bit grows to all
    Run("kelvin_voigt", 20, {**PAPER, "contact.law": "kelvin_voigt"}),
    Run("no_sphere", 20, {**PAPER, "sphere.present": False}),
    Run(
        "random",
        6,
        {
            "drive.waveform": "random",
            "drive.amplitude": 0.5,
            "daq.rate_hz": 50_000,
            "instruments.adc.anti_alias": "butterworth",
            "instruments.faults.planned": FAULTS,
        },
    ),
    Run("restitution", 20, {**PAPER, "contact.law": "restitution"}),
    Run("voltage", 20, {"drive.kind": "voltage", "drive.amplitude": 1.0}),
    Run("walton_braun", 20, {**PAPER, "contact.law": "walton_braun"}),
)

SHORT = (
    Run("short_contacts", 0, {}, record=lambda _: {"contacts": _contacts()}),
    Run("short_friction", 0.2, {**HARD, "sphere.guide_friction": 0.2, "contact.law": "restitution"}),
    Run("short_hertzian", 0.1, HARD),
    Run(
        "short_ideal", 0.1, {**HARD, "drive.waveform": "chirp", "instruments.ideal": True, "contact.law": "restitution"}
    ),
    Run("short_linear", 0.1, {**HARD, "contact.law": "kelvin_voigt", "contact.release": "force"}),
    Run("short_no_sphere", 0.1, {**PAPER, "sphere.present": False, "instruments.faults.planned": SHORT_FAULTS}),
    Run("short_random", 0.05, {"drive.waveform": "random", "drive.amplitude": 2.0, "daq.rate_hz": 50_000}),
    Run("short_voltage", 0.1, {"drive.kind": "voltage", "drive.amplitude": 8.0, "barriers.gap_m": 5e-4}),
    Run("short_walton_braun", 0.1, {**HARD, "contact.law": "walton_braun"}),
)

SOONER = {"drive.frequency_hz": 160.0, "shaker.ramp_s": 0.0, "barriers.gap_m": 5e-5, BLOCK: 100}
"""A sphere that rests on its wall, leaves it and hits the other one in a tenth of the time; the rest is what takes an
interpreter long.
"""
SLOW: dict[str, dict[str, object]] = {
    "short_hertzian": SOONER,
    "short_linear": SOONER,
    "short_voltage": SOONER | {"sphere.present": False},  # contacts are those of the others
    "short_walton_braun": SOONER,
}
QUICK = (
    *(run for run in SHORT if run.name not in SLOW),
    *(
        attrs.evolve(run, name=run.name.replace("short", "quick"), seconds=0.01, values=run.values | SLOW[run.name])
        for run in SHORT
        if run.name in SLOW
    ),
    Run("quick_hits", 0.02, {**HARD, **SOONER, "sphere.start": "centre", "drive.frequency_hz": 9.1}),
)
"""Runs that every test run interprets; the hits of the last one are taken from the table of outcomes. Those that are
not among the short ones have no committed digest: they are compared with the same run, compiled.
"""

INTERPRETED_ELSEWHERE = ("short_contacts", "short_hertzian")
"""Runs for an emulated CPU, interpreted: contacts alone, and a rig with all its instruments."""


def known(runs: tuple[Run, ...]) -> tuple[Run, ...]:
    """Return the runs whose contact law exists in this version."""
    return tuple(run for run in runs if run.values.get("contact.law", "flores") in LAWS)


def _rig(run: Run) -> Streams:
    rig = Rig(from_flat(RigConfig(), {BLOCK: 1000, MONITOR: MONITOR_HZ, **run.values}))
    tables: dict[str, list[Table]] = {topics.INFO.name: [rig.info()]}
    channels = channels_of(np.zeros(0, row_type_of(rig.config.instruments)))
    monitors = AntiAlias(channels, monitor_step(rig.rate_hz, MONITOR_HZ))
    reading = np.dtype([("sample", "i8"), ("status", "i8"), *((name, "f8") for name in channels)])
    for second, (frequency_hz, amplitude) in [*run.commands.items(), (run.seconds, (0.0, 0.0))]:
        for block in rig.advance(round(second * NS_PER_S)):
            found = {
                topics.SCAN.name: block.scan,
                topics.IMPACTS_TRUTH.name: block.impacts,
                topics.FAULTS.name: block.faults,
            }
            found[topics.TRUTH_SCAN.name] = block.truth or Table(block.scan.stamp_ns, block.monitor_states)
            smoothed = monitors.feed(block.first_scan, block.scan.rows)
            if smoothed:
                rows = [(one.sample, one.status, *one.values.values()) for one in smoothed]
                found[MONITORS] = Table(block.scan.stamp_ns, np.array(rows, reading))
            for topic, table in found.items():
                tables.setdefault(topic, []).extend([table] if table is not None else [])
        if second < run.seconds:
            rig.accept(frequency_hz, amplitude)
    tables[topics.APPLIED.name] = rig.take_applied()
    entries = [attrs.evolve(entry, text="") if entry.kind in BEGINNINGS else entry for entry in rig.take_journal()]
    journal = {topics.JOURNAL.name: np.array([(entry.line().encode(),) for entry in entries], [("line", "S4096")])}
    return dict(sorted((journal | {topic: _rows(found) for topic, found in tables.items() if found}).items()))


def _contacts() -> NDArray[np.void]:
    """Return some of the contacts from which the table of outcomes is computed, and their differences."""
    force = contact_laws.from_config(RigConfig().contact).force(ContactPair(1.0, 1.0))
    parameters = unit_parameters(force)
    parameters[0].rtol = outcome.RTOL
    contacts = outcome.Contacts(parameters, compiled_force(force.function))
    found = [contacts.derivatives(eta_0, which)[1:] for eta_0, which in ((0.02, 0), (-0.01, 1))]
    kind = [(f"{order}_{quantity}", "f8") for order in ("first", "second") for quantity in range(outcome.OUTCOMES)]
    return np.array([tuple(np.concatenate(pair)) for pair in found], kind)


def _rows(tables: list[Table]) -> NDArray[np.void]:
    """Return all rows without gaps between their columns."""
    return repack_fields(np.concatenate([table.rows for table in tables]))
