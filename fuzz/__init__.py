# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Hostile inputs for everything that reads the network or a file: `make fuzz`.

A target takes one input, refuses it with an error of this package or accepts it, and checks what it accepted. Anything
else is a finding: another exception, a hang, a NaN, or an acceptance of what should have been refused.
"""
