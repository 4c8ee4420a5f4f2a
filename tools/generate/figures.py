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
"""The table of the figures in `/diagnostics`: key, unit, meaning, by node.

`docs/reference/interface.md` is generated from this table, and a test compares it with what the nodes publish. `<...>`
in a key stands for one word per peer, channel, counter or reason.
"""

from __future__ import annotations

import attrs

from impact_rig import states


@attrs.frozen
class Figure:
    """One figure of a node's status."""

    key: str
    unit: str
    doc: str


EVERY_NODE = (
    *(Figure(key, "-", f"{doc[0].upper()}{doc[1:]}.") for key, doc in states.KEYS.items()),
    Figure("lifecycle", "-", "Label of the lifecycle state."),
    Figure("cpu_percent", "%", "Share of one core this process used since the last report."),
    Figure("refused.<reason>", "-", "Inputs refused so far: by topic, service, `parameter`, `transition`, `inactive`."),
    Figure("last_refused.<reason>", "-", "Reason why the last of them was refused."),
)

RIG = (
    Figure("mode", "-", "`time.mode`."),
    Figure("factor", "-", "`time.factor`."),
    Figure("start_ns", "ns", "Stamp of scan 0: 0 unless in realtime."),
    Figure("rig_time_s", "s", "Rig time since the start or reset."),
    Figure("blocks", "-", "Blocks measured since the activation."),
    Figure("block_rate_hz", "Hz", "Blocks per second of wall time, since the last report."),
    Figure("lost_blocks", "-", "Blocks a lost_block fault has withheld."),
    Figure("lateness_median_ms", "ms", "How late the last 3000 blocks were published; realtime only."),
    Figure("lateness_p99_ms", "ms", "The same, 99th percentile."),
    Figure("lateness_worst_ms", "ms", "The same, worst."),
    Figure("slips", "-", "How often real time was given up because the rig was more than 1 s behind."),
    Figure("slipped_s", "s", "Wall time given up that way."),
    Figure("clock_step_s", "s", "Change of the system clock since the activation; stamps do not follow it."),
    Figure("frequency_hz", "Hz", "Drive frequency."),
    Figure("current_a", "A", "Amplitude commanded (m or V by `drive.kind`)."),
    Figure("latched", "-", "Reason why the shaker is latched; empty if it is not."),
    Figure("impacts", "-", "Contacts that ended, since the activation."),
    Figure("restitution", "-", "`contact.restitution`, the nominal value."),
    Figure("realised_restitution", "-", "Restitution that the contact law gives for it."),
    Figure("energy_work_j", "J", "Work of the drive since the reset or the last change of the mechanics."),
    Figure("energy_lost_j", "J", "Energy dissipated in columns, shaker, contacts and guide, over the same time."),
    Figure("energy_stored_j", "J", "Change of kinetic and potential energy, over the same time."),
    Figure("energy_imbalance", "-", "|work - lost - stored| over the largest of the three: the integration's error."),
    Figure("active_faults", "-", "Number of active instrument faults."),
    Figure("faults", "-", "Active faults: kind/channel, comma-separated."),
    Figure("over_range.<channel>", "-", "Scans flagged over range or clipped, since the activation."),
    Figure("other_publishers", "-", "Other nodes that publish this rig's topics or its clock; must be empty."),
    Figure("subscribers", "-", "Matched subscriptions of daq/scan."),
    Figure("behind.<peer>", "blocks", "Published blocks that a peer has not acknowledged."),
    Figure("lost.<peer>", "blocks", "Blocks that a peer has lost, because it fell behind by more than the rig keeps."),
    Figure("other_acks", "-", "Acknowledgements ignored because no node of that name subscribes to daq/scan."),
)

ANALYSIS = (
    Figure("transmissibility", "-", "Last settled transmissibility."),
    Figure("gap_m", "m", "Parameter `gap_m`."),
    Figure("settling_windows", "-", "Windows since the last change; none without a commanded frequency."),
    Figure(
        "settling_windows_needed", "-", "Windows that the first measurement needs; grows while the transient lasts."
    ),
    Figure("settling_remnant", "-", "Remnant of the transient, relative to the transmissibility."),
    Figure("no_impact_s", "s", "Time without impacts while the sphere may still strike; otherwise 0."),
    Figure("no_impact_limit_s", "s", "Time without impacts after which a row is reported nevertheless; otherwise 0."),
    Figure("<counter>", "-", "Counters of the tracker: scans, lost_scans, measurements, impacts and others."),
)

RECORDER = (
    Figure("directory", "-", "Run that is being written."),
    Figure("messages", "-", "Messages in it."),
    Figure("megabytes", "MB", "Bytes written."),
    Figure("other_publishers", "-", "Nodes that have written the same topic of this run; empty if there are none."),
    Figure("lost.<topic>", "-", "Messages lost before they reached the recorder, by DDS sequence number."),
)

STEPPED_SINE = (
    Figure("points_done", "-", "Points measured or skipped."),
    Figure("points", "-", "Points of the sweep."),
    Figure("frequency_hz", "Hz", "Frequency of the present point."),
    Figure("skipped", "-", "Points left out."),
    Figure("samples", "-", "Samples of a phase lock so far, which has no points."),
    Figure("phase_deg", "deg", "Phase of the superior base in the last sample, relative to `reference`."),
    Figure("locked", "-", "1 while the phase is held within `within_deg`."),
)

FIGURES = {
    "every node": EVERY_NODE,
    "rig": RIG,
    "analysis": ANALYSIS,
    "recorder": RECORDER,
    "stepped_sine": STEPPED_SINE,
}
