# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
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
