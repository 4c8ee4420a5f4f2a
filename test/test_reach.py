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
"""`--changed` leaves out tests that a change cannot reach, and never one that it can."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from kits import reach
from kits.reach import Reach

import impact_rig

pytestmark = pytest.mark.heavy


@pytest.fixture(scope="module")
def checkout() -> Reach:
    return Reach()


def write_tree(root: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)


@pytest.mark.parametrize(
    ("changed", "reached", "left_out"),
    [
        (
            "impact_rig_studies/report/page.py",
            "test/impact_rig_studies/report/test_report.py",
            "test/impact_rig/physics/test_energy.py",
        ),
        ("impact_rig_lab/live.py", "test/impact_rig_lab/test_live_page.py", "test/impact_rig/recording/test_tail.py"),
        (
            "impact_rig/physics/contact/hunt_crossley.py",
            "test/impact_rig/physics/test_contact_laws.py",
            "test/impact_rig/arithmetic/test_random.py",
        ),
        (
            "impact_rig/nodes/rig_node.py",
            "test/impact_rig/pipeline/test_three_processes.py",
            "test/impact_rig/physics/test_energy.py",
        ),
        (
            "impact_rig/cli/export.py",
            "test/impact_rig/cli/test_command_line.py",
            "test/impact_rig/physics/test_energy.py",
        ),
        ("test/kits/browser.py", "test/website/test_accessibility.py", "test/impact_rig/physics/test_energy.py"),
        (
            "qualification/hostile.py",
            "test/impact_rig/recording/test_hostile_recordings.py",
            "test/impact_rig/physics/test_energy.py",
        ),
        ("docs/explanation/rig.md", "test/test_docs.py", "test/impact_rig/physics/test_energy.py"),
        ("test/data/digests.txt", "test/test_digests.py", "test/impact_rig/recording/test_tail.py"),
        ("impact_rig/simulation.py", "test/test_public_names.py", "test/impact_rig/physics/test_energy.py"),
        ("impact_rig/simulation.py", "test/test_claims.py", "test/impact_rig/recording/test_tail.py"),
        ("impact_rig/driver/sample_run.py", "test/test_notebook.py", "test/impact_rig/arithmetic/test_random.py"),
        (
            "impact_rig_lab/static/main.js",
            "test/impact_rig_lab/test_live_page.py",
            "test/impact_rig/arithmetic/test_random.py",
        ),
    ],
)
def test_a_change_reaches_only_the_files_that_use_it(
    checkout: Reach, changed: str, reached: str, left_out: str
) -> None:
    assert (reach.ROOT / changed).is_file()
    found = checkout.files([changed])
    assert found is not None
    assert reached in found
    assert left_out not in found


@pytest.mark.parametrize("changed", ["pyproject.toml", "test/conftest.py", "quite" + "_new.xyz"])
def test_a_change_of_an_unknown_file_reaches_everything(checkout: Reach, changed: str) -> None:
    assert checkout.files(["docs/explanation/rig.md", changed]) is None


def test_an_empty_change_reaches_nothing(checkout: Reach) -> None:
    assert checkout.files([]) == set()


def test_modules_found_in_a_folder_and_started_programs_are_followed(tmp_path: Path) -> None:
    files = {
        "impact_rig/__init__.py": "",
        "impact_rig/laws/__init__.py": "from impact_rig.laws.registry import LAWS",
        "impact_rig/laws/registry.py": "LAWS = [importlib.import_module(name) for name in places]",
        "impact_rig/laws/new.py": "",
        "impact_rig/nodes/__main__.py": "import impact_rig.laws",
        "test/test_program.py": "run([sys.executable, '-m', 'impact_rig.nodes'])",
        "test/test_none.py": '"""As impact_rig.nodes does."""',
        "test/impact_rig_lab/conftest.py": "from impact_rig.laws import LAWS",
        "test/impact_rig_lab/test_page.py": "",
    }
    write_tree(tmp_path, files)
    found = Reach(tmp_path).files(["impact_rig/laws/new.py"])
    assert found is not None
    assert {path for path in found if "/test_" in path} == {"test/test_program.py", "test/impact_rig_lab/test_page.py"}


@pytest.mark.parametrize("name", impact_rig.__all__)
def test_the_module_of_a_public_name_reaches_the_tests_of_all_public_names(checkout: Reach, name: str) -> None:
    module = getattr(impact_rig, name).__module__.replace(".", "/")
    (file,) = (path for path in (f"{module}.py", f"{module}/__init__.py") if (reach.ROOT / path).is_file())
    found = checkout.files([file])
    assert found is not None
    assert {"test/test_public_names.py", "test/test_docs.py"} <= found


@pytest.mark.parametrize(
    "code",
    [
        "import impact_rig\nimpact_rig.simulate(1.0)",
        "from impact_rig import Rig, simulate",
        "from impact_rig import *",
        "import impact_rig as rig\nrig.simulate(1.0)",
        "import impact_rig\ngetattr(impact_rig, chosen)",
        "run([sys.executable, '-c', 'import impact_rig; impact_rig.simulate(1.0)'])",
        "run([sys.executable, '-c', 'from impact_rig import (\\n    Rig,\\n    simulate,\\n)\\nsimulate(1.0)'])",
        "exec(code_of(ROOT / 'docs' / 'page.md'))",
    ],
)
def test_a_public_name_is_followed_to_the_module_that_defines_it(tmp_path: Path, code: str) -> None:
    files = {
        "impact_rig/__init__.py": "if TYPE_CHECKING:\n    from impact_rig.core import Rig\n"
        "    from impact_rig.simulation import simulate\n",
        "impact_rig/core.py": "",
        "impact_rig/simulation.py": "",
        "docs/page.md": "# Page\n\n```python\nimport impact_rig\n\nimpact_rig.simulate(1.0)\n```\n",
        "test/test_user.py": code,
        "test/test_other.py": "import impact_rig\nimpact_rig.Rig()",
    }
    write_tree(tmp_path, files)
    assert Reach(tmp_path).files(["impact_rig/simulation.py"]) == {"impact_rig/simulation.py", "test/test_user.py"}


def test_the_changed_files_are_those_that_git_reports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def git(*words: str) -> None:
        identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
        subprocess.run(["git", *identity, *words], cwd=tmp_path, check=True, capture_output=True)

    monkeypatch.setattr(reach, "ROOT", tmp_path)
    git("init")
    for name in ("kept", "edited", "moved", "removed"):
        (tmp_path / name).write_text(name)
    git("add", ".")
    git("commit", "-m", "first")
    assert reach.changed("HEAD") == []
    (tmp_path / "edited").write_text("otherwise")
    (tmp_path / "removed").unlink()
    (tmp_path / "new").write_text("")
    git("mv", "moved", "elsewhere")
    assert set(reach.changed("HEAD")) == {"edited", "removed", "new", "moved", "elsewhere"}
    git("commit", "-a", "-m", "second")
    assert reach.changed("HEAD") == ["new"]
    assert set(reach.changed("HEAD~")) == {"edited", "removed", "new", "moved", "elsewhere"}


def test_files_that_begin_first_exist(request: pytest.FixtureRequest) -> None:
    """A file with a new name would begin last, and a worker would be alone with it at the end."""
    plugins = request.config.pluginmanager.get_plugins()
    (first,) = [one.LONGEST_FILES for one in plugins if hasattr(one, "LONGEST_FILES")]
    assert set(first) - {path.stem for path in (reach.ROOT / "test").rglob("test_*.py")} == set()
