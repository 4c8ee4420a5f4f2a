# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The kernels of instruments, drive and cycles are ordinary Python as well, and give the same bits."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from kits.measured import measured
from kits.plain_chain import digests


def test_plain_python_gives_the_bits_of_compiled_code():
    program = Path(__file__).parents[2] / "kits" / "plain_chain.py"
    plain = subprocess.run(
        [sys.executable, "-W", "error", str(program)],
        env=measured({**os.environ, "IMPACT_RIG_KERNELS": "plain", "PYTHONPATH": str(program.parents[1])}),
        capture_output=True,
        text=True,
        check=False,
    )
    assert plain.returncode == 0, plain.stderr
    assert plain.stdout.split() == digests()
