# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The one table of states: what each node says about itself on `/diagnostics`, as keys that programs read.

The message of a diagnostic status is a sentence for people and may change; nothing reads a state out of it. Every
status carries the keys of `KEYS`; `state` is one of the words below, the gravest that is true.
"""

from __future__ import annotations

import enum

KEYS = {
    "state": "one word of the node's table",
    "reason": "why, for people; empty where the word says it all",
    "since_ns": "rig time at which the state began [ns since the epoch, a whole number]; empty before rig time exists",
    "instance": "tells this activation of the node from an earlier or another one: 16 hexadecimal digits",
}
"""Keys in the diagnostics of every node, and what they hold; all values are text, as in `diagnostic_msgs/KeyValue`."""


class Rig(enum.StrEnum):
    """What the rig does; the gravest first."""

    INACTIVE = "inactive"  # unconfigured, inactive or finalised: the reason names the lifecycle state
    COMPILING = "compiling"  # kernels are compiled for this machine; nothing runs yet
    RIVAL = "rival"  # somebody else publishes this rig's topics, or holds its namespace
    NO_PEER = "no_peer"  # a peer of time.peers has not subscribed yet
    SILENT_PEER = "silent_peer"  # a peer no longer acknowledges: rig time stands still
    TRIPPED = "tripped"  # the interlock or ~/stop has latched the shaker
    PAUSED = "paused"  # by ~/pause, or stepped and no step asked for
    PLUCKED = "plucked"  # base locked after a pluck, structure swings freely
    AT_REST = "at_rest"  # running, no drive
    DRIVING = "driving"


class Analysis(enum.StrEnum):
    """What the analysis node does; the gravest first."""

    INACTIVE = "inactive"
    NO_SCANS = "no_scans"  # none came yet, or none come any more
    LOST_SCANS = "lost_scans"  # since the last row
    UNABLE = "unable"  # scans come but DT cannot be measured now: the reason is a status of transmissibility/table
    AT_REST = "at_rest"  # no drive
    SETTLING = "settling"
    MEASURING = "measuring"  # the newest row of transmissibility/table holds for the present drive


class Recorder(enum.StrEnum):
    """What the recorder does; the gravest first."""

    INACTIVE = "inactive"
    FAILED = "failed"  # disk full, directory gone, ...: nothing is recorded
    LOSING = "losing"  # messages were lost before they reached it
    WAITING = "waiting"  # a recording is open, something it needs has not come
    RECORDING = "recording"
    IDLE = "idle"


class SteppedSine(enum.StrEnum):
    """What the stepped-sine node does; the gravest first."""

    INACTIVE = "inactive"
    ABORTED = "aborted"
    WAITING = "waiting"  # for nodes or a configuration
    RUNNING = "running"
    DONE = "done"
    IDLE = "idle"


BY_NODE: dict[str, type[enum.StrEnum]] = {
    "rig": Rig,
    "analysis": Analysis,
    "recorder": Recorder,
    "stepped_sine": SteppedSine,
}
"""The words of each node, by its name."""
