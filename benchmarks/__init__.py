# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What `make bench` runs: one file per part, each with `run() -> dict` of the flat keys of build/bench.json."""
