# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What can go wrong between a sensor and a file."""

from __future__ import annotations

FAULT_KINDS = {
    "dropout": "the cable is open: 0 V at the converter",
    "stuck": "the converter repeats its last code",
    "offset_step": "`value` [unit of the channel] is added",
    "gain_error": "the signal grows by the fraction `value`",
    "spike_train": "`rate_hz` spikes per second of ± `value` [unit], at random",
    "saturation": "the signal is limited to ± `value` [unit] and flagged",
    "added_noise": "white noise of `value` rms [unit] is added",
    "lost_block": "blocks are numbered but not published",
    "clock_drift": "the scan clock is off by `value` ppm, on top of daq.clock_error_ppm",
}
BOARD_KINDS = frozenset({"lost_block", "clock_drift"})
"""Faults of the whole board: their channel is empty."""
CHANNEL_KINDS = frozenset(FAULT_KINDS) - BOARD_KINDS
