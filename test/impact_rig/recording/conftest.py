# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A clock that is told the time, and a recording to fill."""

from kits.recording import clock, record

__all__ = ["clock", "record"]
