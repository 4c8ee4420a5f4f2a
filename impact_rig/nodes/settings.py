# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes that do not simulate: flat sections made like the rig's configuration."""

from __future__ import annotations

import attrs

from impact_rig.analysis.settings import TrackerSettings
from impact_rig.config.fields import Origin, choice, integer, quantities, quantity, switch, text
from impact_rig.errors import ConfigError
from impact_rig.operate.phase_lock import LockPlan, Reference
from impact_rig.operate.plan import Direction, Plan
from impact_rig.operate.stepped_sine import ControlledSine, Hold, HoldPlan, SteppedSine

UNKNOWN_GAP = -1.0
COMMAND, PHASE = "command", "phase"
"""What stays constant besides the amplitudes of `Hold`."""


@attrs.frozen(kw_only=True)
class AnalysisSettings(TrackerSettings):
    """Parameters of the analysis node: those of `Tracker`, and what the operator knows."""

    gap_m: float = quantity(
        UNKNOWN_GAP,
        "m",
        "Operator's label: total gap, 0 = no sphere, -1 = unknown; holds from the newest scan on.",
        at_least=UNKNOWN_GAP,
        at_most=1,
    )
    autostart: bool = switch(True, "Configure and activate by itself at start.", read_only=True)

    def __attrs_post_init__(self) -> None:
        super().__attrs_post_init__()
        if UNKNOWN_GAP < self.gap_m < 0:
            raise ConfigError(f"gap_m must be >= 0, or -1 for unknown, got {self.gap_m:g} m")


@attrs.frozen(kw_only=True)
class SteppedSineSettings:
    """Parameters of the stepped-sine node: those of `Plan`, and when to begin."""

    frequencies_hz: tuple[float, ...] = quantities(
        (7.5, 8.0, 8.5, 8.9, 9.0, 9.1, 9.2, 9.5, 10.0, 10.5), "Hz", "The points.", Origin.PAPER, above=0, at_most=1000
    )
    current_a: float = quantity(
        0.52, "A", "Peak current at all points (m or V by drive.kind).", Origin.IDENTIFIED, above=0, at_most=1000
    )
    direction: str = choice("up", tuple(Direction), "Order of the visit; up_down keeps the state between the two.")
    measurements_per_point: int = integer(1, "-", "Measurements taken at each point.", at_least=1, at_most=1000)
    dwell_limit_s: float = quantity(
        150.0, "s", "Rig time at one point after which the sweep is aborted.", above=0, at_most=1e5
    )
    accept_limit_s: float = quantity(
        5.0, "s", "Rig time within which a command must be accepted.", above=0, at_most=1e5
    )
    retries: int = integer(2, "-", "Refused measurements borne per point.", at_least=0, at_most=1000)
    skip_over_range: bool = switch(True, "Leave out a point where a sensor is over range, instead of aborting.")
    keep_unsettled: bool = switch(True, "Take a response that does not settle in the analysis' bound.")
    hold: str = choice(
        "command",
        (COMMAND, *Hold, PHASE),
        "What stays constant: the commanded current, a measured amplitude, for which the current is set anew, or the "
        "phase at -90 degrees, for which the frequency is: sought from the first point on.",
    )
    target: float = quantity(
        60e-6,
        "m or A",
        "Amplitude that is held, peak; of no meaning where hold is command or phase.",
        above=0,
        at_most=1000,
    )
    tolerance: float = quantity(2e-3, "-", "Relative error up to which it counts as held.", above=0, at_most=0.5)
    corrections: int = integer(8, "-", "Of the current per point, at most.", at_least=1, at_most=1000)
    current_limit_a: float = quantity(
        15.0, "A", "A held amplitude that needs more current aborts the sweep.", above=0, at_most=1000
    )
    superior_limit_m: float = quantity(
        0.05, "m", "A larger superior base aborts the sweep while an amplitude is held.", above=0, at_most=1
    )
    reference: str = choice("base", tuple(Reference), "What the superior base's phase is held against.")
    within_deg: float = quantity(
        2.0, "deg", "Deviation of a second's mean phase up to which it counts as locked.", above=0, at_most=90
    )
    dwell_s: float = quantity(
        30.0, "s", "Rig time to stay at the resonance, from the first lock on.", above=0, at_most=1e6
    )
    begin: bool = switch(False, "Begin when the rig is there; otherwise with ~/start.", read_only=True)
    autostart: bool = switch(True, "Configure and activate by itself at start.", read_only=True)

    def __attrs_post_init__(self) -> None:
        self.plan()  # refuses frequencies given twice
        if self.hold == PHASE:
            self.lock_plan()  # refuses a beginning out of its range

    def plan(self) -> Plan:
        """Return the sweep."""
        return Plan(**{attribute.name: getattr(self, attribute.name) for attribute in attrs.fields(Plan)})

    def lock_plan(self) -> LockPlan:
        """Return the search, from the first point on, and what follows it."""
        names = ("current_a", "reference", "within_deg", "dwell_s", "superior_limit_m")
        return LockPlan(start_hz=self.plan().points()[0], **{name: getattr(self, name) for name in names})

    def sweep(self) -> SteppedSine:
        """Return what walks through it, with an amplitude held if that is asked for."""
        if self.hold == COMMAND:
            return SteppedSine(self.plan())
        names = [attribute.name for attribute in attrs.fields(HoldPlan)]
        return ControlledSine(self.plan(), HoldPlan(**{name: getattr(self, name) for name in names}))


@attrs.frozen(kw_only=True)
class RecorderSettings:
    """Parameters of the recorder node."""

    directory: str = text("runs", "Where run directories are made.")
    name: str = text("", "Name of the run directory; empty: run_ and the date and time.")
    record: bool = switch(True, "Start recording on activation; otherwise with ~/start.", read_only=True)
    compression: str = choice("zstd", ("none", "lz4", "zstd"), "Compression of the chunks.")
    max_file_mb: int = integer(0, "MB", "Split files at this size; 0 = never.", at_least=0, at_most=1_000_000)
    configuration_wait_s: float = quantity(
        5.0, "s", "How long a start waits for the rig's configuration before it records without.", at_least=0
    )
    autostart: bool = switch(True, "Configure and activate by itself at start.", read_only=True)
