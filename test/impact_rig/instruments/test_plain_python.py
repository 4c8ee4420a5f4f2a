# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""The kernels of instruments, drive and cycles also run as ordinary Python, and give the same bits."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from kits.measured import measured
from kits.plain_chain import digests


def test_plain_python_yields_the_bits_of_compiled_code():
    program = Path(__file__).parents[2] / "kits" / "plain_chain.py"
    plain = subprocess.run(
        [sys.executable, "-W", "error", str(program)],
        env=measured(
            {
                **os.environ,
                "IMPACT_RIG_KERNELS": "plain",
                "PYTHONPATH": f"{program.parents[2]}{os.pathsep}{program.parents[1]}",
            }
        ),
        capture_output=True,
        text=True,
        check=False,
    )
    assert plain.returncode == 0, plain.stderr
    assert plain.stdout.split() == digests()
