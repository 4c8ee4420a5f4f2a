# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The words the analysis publishes: status, regime and method of a measurement. `docs/analysis.md` explains each."""

from __future__ import annotations

import enum


class Status(enum.StrEnum):
    """What a row of `transmissibility/table` is. Only the first four carry numbers; the others have NaN instead."""

    OK = "ok"
    ACCELEROMETER_OVER_RANGE = "accelerometer_over_range"  # the displacements are sound, the impacts may not be
    ACCELEROMETER_UNSOUND = "accelerometer_unsound"  # dead, or contradicts the laser, which has not changed
    NOT_SETTLED = "not_settled"  # the bound of waiting was reached: numbers given, settled = 0
    LOST_BLOCKS = "lost_blocks"
    OVER_RANGE = "over_range"  # a displacement or the current at or beyond the range of its channel
    COMMAND_CHANGED = "command_changed"  # frequency or current changed while a measurement was under way
    LABEL_CHANGED = "label_changed"
    CALIBRATION_CHANGED = "calibration_changed"
    RESTARTED = "restarted"  # stamps jumped back
    NOT_FINITE = "not_finite"
    NO_FREQUENCY = "no_frequency"  # no, zero or unusable drive frequency
    TOO_FEW_CYCLES = "too_few_cycles"
    SILENCE = "silence"  # neither base nor structure moves measurably
    NO_SIGNAL = "no_signal"  # one of them shows no vibration above its noise while the other does
    CONSTANT = "constant"  # one displacement channel is stuck while the other moves
    TOO_UNCERTAIN = "too_uncertain"  # noise or scatter leave more doubt than `worst_relative_uncertainty`
    BELOW_RESOLUTION = (
        "below_resolution"  # so do the steps of a sensor or converter: the vibration is too small for them
    )
    SPIKES = "spikes"  # a channel jumps and returns from scan to scan, by what neither vibration nor noise makes
    LEVEL_JUMP = "level_jump"  # it jumps and stays there: a step of its zero
    NOISY = "noisy"  # noise far above that of the calibration
    IMPLAUSIBLE = "implausible"  # a channel contradicts the others, or has changed while they have not
    SWAPPED_CHANNELS = "swapped_channels"
    INVERTED_CHANNEL = "inverted_channel"  # laser or base wired the wrong way round: x_1 seems to lead x_b
    IMPACTS = "impacts"  # of a free decay: the sphere strikes while the structure swings
    NOT_EXPONENTIAL = "not_exponential"  # of a free decay: its damping changes with the amplitude
    NO_FIT = "no_fit"  # of the record-wise fits: no convergence, or to something unphysical


MEASURED = frozenset({Status.OK, Status.ACCELEROMETER_OVER_RANGE, Status.ACCELEROMETER_UNSOUND, Status.NOT_SETTLED})
"""The statuses whose rows carry numbers."""


class Regime(enum.StrEnum):
    """What the response of the structure does from cycle to cycle."""

    PERIODIC = "periodic"  # repeats after `period` drive cycles
    MODULATED = "modulated"  # a few spectral lines beside the drive
    CHAOTIC = "chaotic"  # a continuous spectrum
    INTERMITTENT = "intermittent"  # impacts came and stay away: the sphere may be drifting towards the next
    UNKNOWN = "unknown"


class Method(enum.StrEnum):
    """How the uncertainty of a row was found."""

    GUM = "gum"  # noise and calibration, combined
    BATCH_MEANS = "batch_means"  # of a response that is not periodic, combined with the calibration
    NONE = "none"


SETTLED = (Status.OK, Status.ACCELEROMETER_OVER_RANGE, Status.ACCELEROMETER_UNSOUND)
