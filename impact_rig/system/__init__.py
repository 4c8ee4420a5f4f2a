# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The machine around the programs: signals, budgets, files, compiled code kept, plain YAML, what computed a result."""
