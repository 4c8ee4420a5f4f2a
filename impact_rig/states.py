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
"""Words for programs: the states of nodes on `/diagnostics`, and the status, regime and method of a measurement.

The message of a diagnostic status is a sentence for people and may change; programs must not parse it. Every status
carries the keys of `KEYS`. Its `state` is one of the words below, the most severe that applies. The words of a
measurement are those of `transmissibility/table`; `docs/explanation/analysis.md` explains each. The level of a status
(OK, WARN, ERROR) is not derived from its word: each node decides it in `ManagedNode.health`.
"""

from __future__ import annotations

import enum
from typing import Self

KEYS = {
    "state": "state: one word of the node's table",
    "reason": "readable reason; empty if the word says enough",
    "since_ns": (
        "rig time at which the state began [ns since the epoch, a whole number]; empty before rig time exists"
    ),
    "instance": "identifier of this activation of the node: 16 hexadecimal digits",
}
"""Keys in the diagnostics of every node, with their content; all values are text, as in `diagnostic_msgs/KeyValue`."""


class Word(enum.StrEnum):
    """Word that a program can compare like a text; its attribute `doc` explains it to people."""

    doc: str

    def __new__(cls, word: str, doc: str = "") -> Self:
        """Create a member of an enumeration, which equals the text `word`; `doc` becomes its attribute `doc`."""
        member = str.__new__(cls, word)
        member._value_ = word
        member.doc = doc
        return member


class RigWord(Word):
    """States of the rig node, the most severe first."""

    INACTIVE = "inactive", "unconfigured, inactive or finalised: the reason begins with the lifecycle state"
    RIVAL = "rival", "another node publishes this rig's topics, or holds its namespace"
    NO_PEER = "no_peer", "a peer of `time.peers` has not subscribed yet, and rig time waits for it"
    SILENT_PEER = (
        "silent_peer",
        "a peer does not acknowledge, or a controller sends no samples: rig time stands still",
    )
    TRIPPED = "tripped", "the interlock or `~/stop` has latched the shaker: the reason names which"
    PAUSED = "paused", "paused by `~/pause`; or in lockstep without a step request for a second"
    PLUCKED = "plucked", "base locked after a pluck, structure swings freely"
    AT_REST = "at_rest", "running, no drive"
    DRIVING = "driving", "running, an amplitude is commanded or samples of a stream act"


class AnalysisWord(Word):
    """States of the analysis node, the most severe first."""

    INACTIVE = "inactive", "unconfigured, inactive or finalised: the reason begins with the lifecycle state"
    NO_SCANS = "no_scans", "no scans received yet, or none for two seconds"
    LOST_SCANS = "lost_scans", "scans were lost since the last row"
    UNABLE = (
        "unable",
        "scans arrive but DT cannot be measured now: the reason is a status of `transmissibility/table`",
    )
    AT_REST = "at_rest", "no drive"
    SETTLING = "settling", "waiting until the response to the present drive has settled"
    MEASURING = "measuring", "the newest row of `transmissibility/table` applies to the present drive"


class RecorderWord(Word):
    """States of the recorder node, the most severe first."""

    INACTIVE = "inactive", "unconfigured, inactive or finalised: the reason begins with the lifecycle state"
    FAILED = "failed", "disk full, directory gone, ...: nothing is recorded"
    RIVAL = (
        "rival",
        "another node has written a topic of this run that only one node may write: the run cannot be verified",
    )
    LOSING = "losing", "messages of this run were lost before they reached the recorder, or were invalid"
    WAITING = "waiting", "a recording is requested, but something it needs is missing"
    RECORDING = "recording", "all received messages are written"
    IDLE = "idle", "no recording"


class PlotWord(Word):
    """States of the plot node, which derives topics for plotters from scans."""

    INACTIVE = "inactive", "unconfigured, inactive or finalised: the reason begins with the lifecycle state"
    PLOTTING = "plotting", "a plotter subscribes to a topic derived from scans"
    IDLE = "idle", "no plotter subscribes, so the node does not subscribe to scans"


class SteppedSineWord(Word):
    """States of the stepped-sine node, the most severe first."""

    INACTIVE = "inactive", "unconfigured, inactive or finalised: the reason begins with the lifecycle state"
    ABORTED = "aborted", "the last sweep ended before its plan: the reason says why"
    WAITING = "waiting", "waiting for nodes or a configuration"
    RUNNING = "running", "a sweep or a phase lock is running"
    DONE = "done", "the last sweep completed its plan"
    IDLE = "idle", "no sweep was requested"


NodeWord = RigWord | AnalysisWord | RecorderWord | PlotWord | SteppedSineWord
BY_NODE: dict[str, type[NodeWord]] = {
    "rig": RigWord,
    "analysis": AnalysisWord,
    "recorder": RecorderWord,
    "plot": PlotWord,
    "stepped_sine": SteppedSineWord,
}
"""State words of each node, by the node's name; if several states apply, the node reports the one defined first."""


class Status(Word):
    """Status of a row of `transmissibility/table`, or of a free decay.

    Only rows with one of the first six statuses (`MEASURED`) contain DT. In other rows, DT and related columns are NaN.
    """

    OK = "ok", "DT of a settled response was measured."
    NO_IMPACTS = (
        "no_impacts",
        "DT was measured, and no impact was detected while waiting; a very slow sphere could still strike.",
    )
    ACCELEROMETER_OVER_RANGE = (
        "accelerometer_over_range",
        "DT was measured, but the accelerometer was over range: the detected impacts may be wrong.",
    )
    ACCELEROMETER_UNSOUND = (
        "accelerometer_unsound",
        "DT was measured, but the accelerometer is dead or contradicts the laser.",
    )
    CURRENT_UNSOUND = (
        "current_unsound",
        "DT was measured, but the current channel is dead, disturbed, or changed while the motion did not.",
    )
    NOT_SETTLED = "not_settled", "The longest wait is over and the response still changes: DT may drift."
    LOST_BLOCKS = "lost_blocks", "Blocks of scans were missing; a measurement in progress ended."
    OVER_RANGE = "over_range", "A displacement or the current was at or beyond the range of its channel."
    COMMAND_CHANGED = "command_changed", "Frequency or current changed during the measurement."
    LABEL_CHANGED = "label_changed", "The gap label changed during the measurement."
    CALIBRATION_CHANGED = "calibration_changed", "The calibration changed during the measurement."
    RESTARTED = "restarted", "The stamps of the scans jumped back during the measurement."
    NOT_FINITE = "not_finite", "A scan contains a value that is NaN or infinite."
    NO_FREQUENCY = "no_frequency", "There is no drive frequency to measure at."
    TOO_FEW_CYCLES = "too_few_cycles", "The record holds too few cycles of the drive."
    SILENCE = "silence", "Neither base nor structure moves measurably."
    NO_SIGNAL = "no_signal", "A channel shows no vibration above its noise while another does."
    CONSTANT = "constant", "A displacement channel stands still while the other moves: stuck, or its cable open."
    TOO_UNCERTAIN = "too_uncertain", "Noise or scatter make the result more uncertain than allowed."
    BELOW_RESOLUTION = "below_resolution", "The vibration is too small for the steps of a sensor or of the converter."
    SPIKES = "spikes", "A channel jumps and returns from scan to scan, which neither vibration nor noise does."
    LEVEL_JUMP = "level_jump", "A channel jumps and stays there: a step of its zero."
    NOISY = "noisy", "The noise of a channel is far above that of its calibration."
    IMPLAUSIBLE = "implausible", "A channel contradicts the others, or has changed while they have not."
    SWAPPED_CHANNELS = "swapped_channels", "Laser and base seem to be exchanged."
    INVERTED_CHANNEL = "inverted_channel", "Laser or base has the wrong polarity: x_1 seems to lead x_b."
    IMPACTS = "impacts", "A free decay with impacts: its damping is not that of the structure."
    NOT_EXPONENTIAL = "not_exponential", "A free decay at two rates: no single damping ratio describes it."
    NO_FIT = "no_fit", "A fit did not converge, or converged to values that are physically impossible."


SETTLED = (
    Status.OK,
    Status.NO_IMPACTS,
    Status.ACCELEROMETER_OVER_RANGE,
    Status.ACCELEROMETER_UNSOUND,
    Status.CURRENT_UNSOUND,
)
"""Statuses of rows of `transmissibility/table` that contain the DT of a settled response."""
MEASURED = frozenset({*SETTLED, Status.NOT_SETTLED})
"""Statuses of rows with numbers: DT of a settled response, or of one that still changes (`not_settled`)."""


class Regime(Word):
    """Regime of the response: its behaviour from cycle to cycle."""

    PERIODIC = "periodic", "The response repeats after whole drive cycles."
    MODULATED = "modulated", "The response has a few spectral lines in addition to the drive."
    CHAOTIC = "chaotic", "The response has a continuous spectrum; DT is its coherent mean."
    INTERMITTENT = "intermittent", "Impacts are absent for seconds and return: the sphere drifts between the walls."
    UNKNOWN = "unknown", "There are too few cycles to decide, or an unsound accelerometer hides the impacts."


class Method(enum.StrEnum):
    """Method by which the uncertainty of a row of `transmissibility/table` was found: GUM, batch means or none."""

    GUM = "gum"  # combination of noise and calibration
    BATCH_MEANS = "batch_means"  # for a response that is not periodic; combined with the calibration
    NONE = "none"  # the row has no uncertainty
