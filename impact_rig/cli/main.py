"""Parse the command line and run one subcommand; errors become one clear line and exit code 1."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import impact_rig
from impact_rig.cli import campaign, check, demo, identify, recovery, replay, report, runs
from impact_rig.errors import ImpactRigError

EXIT_ERROR = 1
EXIT_INTERRUPTED = 130


def command_line() -> argparse.ArgumentParser:
    """Return the parser of all subcommands."""
    parser = argparse.ArgumentParser(
        prog="impact-rig", description="The test rig of an impact damper as virtual hardware."
    )
    parser.add_argument("--version", action="version", version=f"impact-rig {impact_rig.__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for module in (check, demo, campaign, report, runs, recovery, replay, identify):
        module.add_commands(commands)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `impact-rig` and return the exit code."""
    chosen = command_line().parse_args(arguments)
    try:
        result: int = chosen.run(chosen)
    except ImpactRigError as error:
        print(f"impact-rig {chosen.command}: {error}", file=sys.stderr)  # noqa: T201  # a command line tool talks
        return EXIT_ERROR
    except KeyboardInterrupt:
        print(f"impact-rig {chosen.command}: interrupted", file=sys.stderr)  # noqa: T201
        return EXIT_INTERRUPTED
    return result
