# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The words the analysis publishes: status, regime and method of a measurement. `docs/analysis.md` explains each."""

from __future__ import annotations

import enum

from impact_rig.states import Word


class Status(Word):
    """What a row of `transmissibility/table` is. Only the first four carry numbers; the others have NaN instead."""

    OK = "ok", "A measurement."
    ACCELEROMETER_OVER_RANGE = "accelerometer_over_range", "The displacements are sound, the impacts may not be."
    ACCELEROMETER_UNSOUND = "accelerometer_unsound", "Dead, or contradicts the laser: the displacements are sound."
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


MEASURED = frozenset({Status.OK, Status.ACCELEROMETER_OVER_RANGE, Status.ACCELEROMETER_UNSOUND, Status.NOT_SETTLED})
"""The statuses whose rows carry numbers."""


class Regime(Word):
    """What the response of the structure does from cycle to cycle."""

    PERIODIC = "periodic", "The response repeats after whole drive cycles."
    MODULATED = "modulated", "The response has a few spectral lines beside the drive."
    CHAOTIC = "chaotic", "The response has a continuous spectrum; DT is its coherent mean."
    INTERMITTENT = "intermittent", "Impacts came and stay away: the sphere may be drifting towards the next."
    UNKNOWN = "unknown", "There are too few cycles to tell."


class Method(enum.StrEnum):
    """How the uncertainty of a row was found."""

    GUM = "gum"  # noise and calibration, combined
    BATCH_MEANS = "batch_means"  # of a response that is not periodic, combined with the calibration
    NONE = "none"


SETTLED = (Status.OK, Status.ACCELEROMETER_OVER_RANGE, Status.ACCELEROMETER_UNSOUND)
