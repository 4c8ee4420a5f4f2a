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
"""The worked notebook runs from its first cell to its last, in its own kernel, and is stored without output."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

nbclient = pytest.importorskip("nbclient", reason="make venv installs what runs notebooks")
nbformat = pytest.importorskip("nbformat", reason="make venv installs what reads notebooks")

NOTEBOOK = Path(__file__).parents[1] / "examples" / "recorded_run.ipynb"
PATIENCE_S = 280


def test_the_notebook_is_stored_without_output():
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    assert [cell["id"] for cell in cells if cell.get("outputs") or cell.get("execution_count")] == []


@pytest.fixture(scope="module")
def executed(tmp_path_factory):
    """The notebook after a run in an empty directory."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    directory = tmp_path_factory.mktemp("notebook")
    client = nbclient.NotebookClient(
        notebook, timeout=PATIENCE_S, kernel_name="python3", resources={"metadata": {"path": str(directory)}}
    )
    client.execute()
    return notebook


def outputs(notebook, kind):
    return [output for cell in notebook.cells for output in cell.get("outputs", ()) if output.output_type == kind]


def test_every_cell_runs_and_prints_its_result(executed):
    said = "".join(output.text for output in outputs(executed, "stream") if output.name == "stdout")
    assert "none missing" in said
    assert "analysis: DT = 63." in said
    assert "10 mm: 48.3 % (paper 49 %)" in said


def test_no_cell_prints_a_warning(executed):
    assert [output.text for output in outputs(executed, "stream") if output.name == "stderr"] == []


def test_the_notebook_draws_its_four_figures(executed):
    assert len([output for output in outputs(executed, "display_data") if "image/png" in output.data]) == 4
