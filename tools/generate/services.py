# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The one table of services and commands: name, type, what it does, and in which situations of its node it is taken.

`docs/interface.md` is written from this table, and a test asks every service in every situation.
"""

from __future__ import annotations

import enum

import attrs

from impact_rig import topics

TRIGGER, SET_BOOL = "std_srvs/srv/Trigger", "std_srvs/srv/SetBool"


class Situation(enum.StrEnum):
    """What a node can be in the middle of: a lifecycle state, and within `active` what matters to its inputs."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    RUNNING = "active"
    PAUSED = "active, paused"
    LATCHED = "active, latched"  # by ~/stop or the interlock
    PLUCKED = "active, plucked"  # the base is locked
    FINALIZED = "finalized"


_ACTIVE = frozenset({Situation.RUNNING, Situation.PAUSED, Situation.LATCHED, Situation.PLUCKED})
_ANY = frozenset(Situation)


@attrs.frozen
class Input:
    """One row: a service, or the topic of a command."""

    name: str  # topic, or private service name
    type_name: str  # ROS interface; empty for a topic, whose type the table of topics has
    node: str  # node that takes it
    doc: str  # what it does
    taken: frozenset[Situation]
    """The situations in which it is taken; in the others it is refused with a message and counted."""


COMMANDS = (
    Input(topics.FREQUENCY.name, "", "rig", "Drive frequency.", frozenset({Situation.RUNNING, Situation.PAUSED})),
    Input(topics.CURRENT.name, "", "rig", "Drive amplitude.", frozenset({Situation.RUNNING, Situation.PAUSED})),
)

SERVICES = (
    Input(
        "~/pause",
        SET_BOOL,
        "rig",
        "true: hold rig time; answered when the peers have processed all that is out. false: go on, without what a "
        "silent peer missed, and where others are followed without that peer until it acknowledges again.",
        _ACTIVE,
    ),
    Input(
        "~/step",
        TRIGGER,
        "rig",
        "Advance by `step.blocks`, while paused or with `time.mode: stepped`; answered when the last block is out and "
        "acknowledged by all `time.peers`. A paused rig stays paused.",
        _ACTIVE,
    ),
    Input(
        "~/reset",
        TRIGGER,
        "rig",
        "Begin again with the present configuration: scan 0, everything at rest; stamps go on, a new journal begins.",
        _ACTIVE - {Situation.LATCHED},
    ),
    Input("~/stop", TRIGGER, "rig", "Emergency stop: ramp to zero within `shaker.ramp_s`, and latch.", _ACTIVE),
    Input(
        "~/clear_trip",
        TRIGGER,
        "rig",
        "Release the latch of ~/stop or of the interlock; the amplitude stays zero until the next command.",
        _ACTIVE,
    ),
    Input(
        "~/pluck",
        TRIGGER,
        "rig",
        "Lock the base and release x_1 from `pluck.displacement_m`: free decay until ~/reset.",
        _ACTIVE,
    ),
    Input(
        "~/start",
        TRIGGER,
        "recorder",
        "Start a recording; answered with its directory once it holds calibration, configuration, present command and "
        "journal. Refused while there is one.",
        frozenset({Situation.RUNNING}),
    ),
    Input(
        "~/start",
        TRIGGER,
        "stepped_sine",
        "Begin a sweep, or the search for a resonance. Refused while one is under way, or while rig or analysis are "
        "not there.",
        frozenset({Situation.RUNNING}),
    ),
    Input("~/stop", TRIGGER, "stepped_sine", "Abort the sweep or the lock, the shaker at rest.", _ANY),
    Input("~/stop", TRIGGER, "recorder", "Finish the recording; answered with its directory.", _ANY),
)
"""Every service besides those of ROS itself (parameters, lifecycle)."""
