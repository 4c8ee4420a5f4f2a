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
"""The words that programs read: what nodes say about themselves on `/diagnostics`, and the analysis of a measurement.

The message of a diagnostic status is a sentence for people and may change; nothing reads a state out of it. Every
status carries the keys of `KEYS`; `state` is one of the words below, the gravest that is true. Status, regime and
method of a measurement are those of `transmissibility/table`; `docs/explanation/analysis.md` explains each. How grave a
state is, each node decides for itself (`health`).
"""

from __future__ import annotations

import enum
from typing import Self

KEYS = {
    "state": "one word of the node's table",
    "reason": "why, for people; empty where the word says it all",
    "since_ns": "rig time at which the state began [ns since the epoch, a whole number]; empty before rig time exists",
    "instance": "tells this activation of the node from an earlier or another one: 16 hexadecimal digits",
}
"""Keys in the diagnostics of every node, and what they hold; all values are text, as in `diagnostic_msgs/KeyValue`."""


class Word(enum.StrEnum):
    """A word and what it means."""

    doc: str

    def __new__(cls, word: str, doc: str = "") -> Self:
        """Make a member of a word and what it means."""
        member = str.__new__(cls, word)
        member._value_ = word
        member.doc = doc
        return member


class RigWord(Word):
    """What the rig does; the gravest first."""

    INACTIVE = "inactive", "unconfigured, inactive or finalised: the reason begins with the lifecycle state"
    RIVAL = "rival", "somebody else publishes this rig's topics, or holds its namespace"
    NO_PEER = "no_peer", "a peer of `time.peers` has not subscribed yet, and rig time waits for it"
    SILENT_PEER = (
        "silent_peer",
        "a peer no longer acknowledges, or a controller sends no samples: rig time stands still",
    )
    TRIPPED = "tripped", "the interlock or `~/stop` has latched the shaker: the reason says which"
    PAUSED = "paused", "by `~/pause`; or in lockstep, and for a second no step was asked for"
    PLUCKED = "plucked", "base locked after a pluck, structure swings freely"
    AT_REST = "at_rest", "running, no drive"
    DRIVING = "driving", "running, an amplitude is commanded"


class AnalysisWord(Word):
    """What the analysis node does; the gravest first."""

    INACTIVE = "inactive", "unconfigured, inactive or finalised: the reason begins with the lifecycle state"
    NO_SCANS = "no_scans", "none came yet, or none for two seconds"
    LOST_SCANS = "lost_scans", "since the last row scans were lost"
    UNABLE = ("unable", "scans come but DT cannot be measured now: the reason is a status of `transmissibility/table`")
    AT_REST = "at_rest", "no drive"
    SETTLING = "settling", "the response to the present drive is awaited"
    MEASURING = "measuring", "the newest row of `transmissibility/table` holds for the present drive"


class RecorderWord(Word):
    """What the recorder does; the gravest first."""

    INACTIVE = "inactive", "unconfigured, inactive or finalised: the reason begins with the lifecycle state"
    FAILED = "failed", "disk full, directory gone, ...: nothing is recorded"
    RIVAL = ("rival", "another node has written a topic of this run that is one node's: it cannot be verified")
    LOSING = "losing", "messages of this run were lost before they reached it, or were no tables of their topic"
    WAITING = "waiting", "a recording is asked for, something it needs has not come"
    RECORDING = "recording", "all that came is written"
    IDLE = "idle", "no recording"


class PlotWord(Word):
    """What the plot node does."""

    INACTIVE = "inactive", "unconfigured, inactive or finalised: the reason begins with the lifecycle state"
    PLOTTING = "plotting", "a plotter subscribes to what is made of scans"
    IDLE = "idle", "no plotter subscribes, so no scans are followed"


class SteppedSineWord(Word):
    """What the stepped-sine node does; the gravest first."""

    INACTIVE = "inactive", "unconfigured, inactive or finalised: the reason begins with the lifecycle state"
    ABORTED = "aborted", "the last sweep ended before its plan: the reason says why"
    WAITING = "waiting", "for nodes or a configuration"
    RUNNING = "running", "a sweep or a phase lock is under way"
    DONE = "done", "the last sweep went through its plan"
    IDLE = "idle", "no sweep was asked for"


NodeWord = RigWord | AnalysisWord | RecorderWord | PlotWord | SteppedSineWord
BY_NODE: dict[str, type[NodeWord]] = {
    "rig": RigWord,
    "analysis": AnalysisWord,
    "recorder": RecorderWord,
    "plot": PlotWord,
    "stepped_sine": SteppedSineWord,
}
"""The words of each node, by its name."""


class Status(Word):
    """What a row of `transmissibility/table` is. Only the first six carry numbers; the others have NaN instead."""

    OK = "ok", "A measurement."
    NO_IMPACTS = "no_impacts", "A measurement without impacts: a sphere slower than was waited for could still strike."
    ACCELEROMETER_OVER_RANGE = "accelerometer_over_range", "The displacements are sound, the impacts may not be."
    ACCELEROMETER_UNSOUND = "accelerometer_unsound", "Dead, or contradicts the laser: the displacements are sound."
    CURRENT_UNSOUND = "current_unsound", "Dead, disturbed, or changed alone: the displacements are sound."
    NOT_SETTLED = "not_settled", "The longest wait is over and the response still changes: DT may drift."
    LOST_BLOCKS = "lost_blocks", "Blocks of scans were missing while it was measured."
    OVER_RANGE = "over_range", "A displacement or the current was at or beyond the range of its channel."
    COMMAND_CHANGED = "command_changed", "Frequency or current changed while it was measured."
    LABEL_CHANGED = "label_changed", "The gap was set anew while it was measured."
    CALIBRATION_CHANGED = "calibration_changed", "The calibration changed while it was measured."
    RESTARTED = "restarted", "The scans began anew."
    NOT_FINITE = "not_finite", "A scan was no number."
    NO_FREQUENCY = "no_frequency", "There is no drive frequency to measure at."
    TOO_FEW_CYCLES = "too_few_cycles", "The record holds too few cycles of the drive."
    SILENCE = "silence", "Neither base nor structure moves measurably."
    NO_SIGNAL = "no_signal", "A channel shows no vibration above its noise while another does."
    CONSTANT = "constant", "A displacement channel stands still while the other moves: stuck, or its cable open."
    TOO_UNCERTAIN = "too_uncertain", "Noise or scatter leave more doubt than a measurement may have."
    BELOW_RESOLUTION = "below_resolution", "The vibration is too small for the steps of a sensor or of the converter."
    SPIKES = "spikes", "A channel jumps and returns from scan to scan, as neither vibration nor noise does."
    LEVEL_JUMP = "level_jump", "A channel jumps and stays there: a step of its zero."
    NOISY = "noisy", "The noise of a channel is far above that of its calibration."
    IMPLAUSIBLE = "implausible", "A channel contradicts the others, or has changed while they have not."
    SWAPPED_CHANNELS = "swapped_channels", "Laser and base look exchanged."
    INVERTED_CHANNEL = "inverted_channel", "Laser or base is wired the wrong way round: x_1 seems to lead x_b."
    IMPACTS = "impacts", "A free decay with impacts: its damping is not that of the structure."
    NOT_EXPONENTIAL = "not_exponential", "A free decay at two rates: no single damping ratio describes it."
    NO_FIT = "no_fit", "A fit did not converge, or to something unphysical."


SETTLED = (
    Status.OK,
    Status.NO_IMPACTS,
    Status.ACCELEROMETER_OVER_RANGE,
    Status.ACCELEROMETER_UNSOUND,
    Status.CURRENT_UNSOUND,
)
"""The statuses of a response that has settled."""
MEASURED = frozenset({*SETTLED, Status.NOT_SETTLED})
"""The statuses whose rows carry numbers."""


class Regime(Word):
    """What the response of the structure does from cycle to cycle."""

    PERIODIC = "periodic", "The response repeats after whole drive cycles."
    MODULATED = "modulated", "The response has a few spectral lines beside the drive."
    CHAOTIC = "chaotic", "The response has a continuous spectrum; DT is its coherent mean."
    INTERMITTENT = "intermittent", "Impacts stay away for seconds and come again: the sphere drifts between the walls."
    UNKNOWN = "unknown", "There are too few cycles to tell, or an unsound accelerometer tells no impacts."


class Method(enum.StrEnum):
    """How the uncertainty of a row was found."""

    GUM = "gum"  # noise and calibration, combined
    BATCH_MEANS = "batch_means"  # of a response that is not periodic, combined with the calibration
    NONE = "none"
