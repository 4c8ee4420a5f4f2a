# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`impact-rig report`: the page of a campaign."""

from __future__ import annotations

import argparse
from pathlib import Path

from impact_rig.cli.terminal import subcommand, tell_program


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = subcommand(
        commands, "report", "write a campaign's report: one HTML page, figures as PNG and SVG, numbers as JSON",
        [
            ("report runs/campaign_paper", "writes runs/campaign_paper/report.html"),
            ("report runs/campaign_paper --margins runs/campaign_margins", "with what the verdicts owe to constants"),
        ],
    )  # fmt: skip
    parser.add_argument("directory", type=Path, metavar="DIR", help="directory of a campaign")
    parser.add_argument("--output", type=Path, metavar="FILE", help="the page (default: DIR/report.html)")
    parser.add_argument(
        "--margins", type=Path, metavar="DIR",
        help="campaign that varies constants (config/campaigns/margins.yaml): what the statements owe to them",
    )  # fmt: skip
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    from impact_rig.report import build_report  # noqa: PLC0415  # loads SciPy, which no other command needs

    path = build_report(arguments.directory, arguments.output, arguments.margins)
    tell_program(path)
    return 0
