"""The command `impact-rig`: every subcommand is a file of this package."""

from impact_rig.cli.main import main

__all__ = ["main"]
