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
"""The analysis as plain Python finds the same as the compiled one: debuggers and coverage see the same loops."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from kits.measured import measured
from kits.tracker import run_scenario

TESTS = Path(__file__).parents[2]
SCRIPT = """
import sys
import numpy as np
from kits.tracker import run_scenario
from impact_rig import kernels
assert kernels.MODE == "plain"
measurements, impacts, _ = run_scenario(1000)
tables = {"measurements": measurements, "impacts": impacts}
np.savez(sys.argv[1], **{name: np.concatenate([table.rows for table in found]) for name, found in tables.items()})
"""


def test_plain_python_measures_the_same_as_compiled_code(tmp_path: Path) -> None:
    """The results agree to 1e-9, as between machines, because the analysis may use all functions of its libraries."""
    output = tmp_path / "plain.npz"
    environment = measured(
        {**os.environ, "IMPACT_RIG_KERNELS": "plain", "PYTHONPATH": f"{TESTS.parent}{os.pathsep}{TESTS}"}
    )
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(output)], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
    measurements, impacts, _ = run_scenario(1000)
    with np.load(output) as plain:
        for name, tables in (("measurements", measurements), ("impacts", impacts)):
            rows = np.concatenate([table.rows for table in tables])
            assert len(plain[name]) == len(rows) > 0, name
            for column in rows.dtype.names or ():
                if rows.dtype[column].kind in "fiu":
                    np.testing.assert_allclose(plain[name][column], rows[column], rtol=1e-9, atol=1e-12, err_msg=column)
                else:
                    assert (plain[name][column] == rows[column]).all(), column
