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
"""Tracker that is ready to measure, records on which it settles, and one scenario with every interruption."""

from __future__ import annotations

import functools

import numpy as np
from kits.records import add_impacts, applied, blocks, info_rows, steady_record

from impact_rig.analysis.settings import TrackerSettings
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import Table
from impact_rig.simtime import NS_PER_S

RATE = 2000  # enough for 9.1 Hz and quick; the detector works from 2 kS/s on
QUICK = TrackerSettings(window_s=0.1)


def tracker(frequency_hz=9.1, *, rate_hz=RATE, tracker_settings=QUICK, start_ns=0, gap_m=0.0, info=None):
    made = Tracker(tracker_settings)
    made.configure(Table(start_ns, info_rows(rate_hz) if info is None else info))
    if frequency_hz is not None:
        made.on_applied(applied(frequency_hz, at_ns=start_ns))
    made.label(gap_m, start_ns)
    return made


def record(frequency_hz=9.1, seconds=14.0, *, rate_hz=RATE, seed=1, **options):
    return steady_record(frequency_hz, seconds, rate_hz=rate_hz, rng=np.random.default_rng(seed), **options)


@functools.cache
def scenario(rate_hz=RATE):
    """Rows and events of the scenario: a change of frequency, an over-range, a NaN, impacts and a gap."""
    rng = np.random.default_rng(3)
    first = steady_record(9.1, 9.0, rate_hz=rate_hz, rng=rng)
    second = steady_record(9.5, 27.0, rate_hz=rate_hz, rng=rng)
    rows = np.concatenate([first, second])
    rows["status"][int(17.0 * rate_hz) : int(17.3 * rate_hz)] = 2
    rows["laser"][int(23.5 * rate_hz)] = np.nan
    times = np.arange(0.5, 35.0, 0.0511)
    add_impacts(
        rows["accelerometer"], rate_hz, times, np.full(len(times), 0.4), np.tile([1, -1], len(times))[: len(times)]
    )
    hole = (int(29.013 * rate_hz), int(29.1 * rate_hz))
    return rows, hole


def run_scenario(sizes, *, late_ns=0, rate_hz=RATE, start_ns=0):
    """Feed the scenario; the command for 9.5 Hz is delivered `late_ns` after the scan it acts on."""
    rows, hole = scenario(rate_hz)
    made = tracker(rate_hz=rate_hz, start_ns=start_ns)
    parts = [(rows[: hole[0]], 0), (rows[hole[1] :], hole[1])]
    change_ns = start_ns + 9 * NS_PER_S
    found, sent = [], False
    for part, first in parts:
        for table in blocks(part, rate_hz, sizes() if callable(sizes) else sizes, start_ns=start_ns, first=first):
            end_ns = table.stamp_ns + len(table.rows) * NS_PER_S // rate_hz
            if not sent and end_ns > change_ns + late_ns:  # the rig accepts a command before it simulates its instant
                made.on_applied(applied(9.5, at_ns=change_ns))
                sent = True
            found.append(made.feed(table))
    found.append(made.flush())
    measurements = [table for one in found for table in one.measurements]
    impacts = [table for one in found for table in one.impacts]
    return measurements, impacts, made


def fingerprint(measurements, impacts):
    rows = b"".join(table.stamp_ns.to_bytes(8, "big", signed=True) + table.rows.tobytes() for table in measurements)
    hits = b"".join(
        table.stamp_ns.to_bytes(8, "big", signed=True) + row.tobytes() for table in impacts for row in table.rows
    )
    return rows, hits
