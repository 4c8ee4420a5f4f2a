# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The command `impact-rig`: its subcommands, each with what it prints."""

from impact_rig.cli.main import main

__all__ = ["main"]
