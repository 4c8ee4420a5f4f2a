# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Proves that every machine gives the same bits: fixed runs, their digests, and masks that make one CPU look older."""
