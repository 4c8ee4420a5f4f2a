# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The nodes as programs: `python -m impact_rig.nodes rig --ros-args ...`, and the console scripts.

Light on purpose: signals and the end of the parent are taken care of before anything heavy is imported.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
import time

from impact_rig.system.endings import PARENT_VARIABLE, PATIENCE_S, Ending, end_with


def rig() -> None:
    """Run the rig."""
    _run("rig")


def analysis() -> None:
    """Run the analysis."""
    _run("analysis")


def recorder() -> None:
    """Run the recorder."""
    _run("recorder")


def stepped_sine() -> None:
    """Run the stepped sine."""
    _run("stepped_sine")


def _run(node: str) -> None:
    # a node that is told to end has done its work: launch takes any other code for a crash
    ending = Ending(f"{node}_node", code=lambda _number: 0)
    parent = int(os.environ.get(PARENT_VARIABLE, "0"))
    if parent:
        end_with(parent, lambda: _end(ending))
    importlib.import_module(f"impact_rig.nodes.{node}_node").main(ending)


def _end(ending: Ending) -> None:
    """End in order, or after a while in any way: nobody is there to do it."""
    ending.reason = ", as the process that started it is gone"
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(PATIENCE_S)
    os._exit(1)


if __name__ == "__main__":
    _run(sys.argv.pop(1))
