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
"""Recipes of docs/how-to/extending.md, followed to the letter in a copy of the repository: no other file is edited.

They are done one after another in one copy. Then the commands of the page follow, the tests of the additions and those
of the pages. With `--thorough`, each recipe has its own copy, which shows that none needs another one.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import attrs
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from tools import doc_paths, recipes
from tools.generate import ROOT, generated

OF_PAGES = (
    "test/test_claims.py",
    "test/test_config_files.py",
    "test/test_docs.py",
    "test/test_figures.py",
    "test/test_generated.py",
    "test/test_layers.py",
    "test/test_licence.py",
    "test/test_public_names.py",
)
"""Tests that compare pages, figures and all sources with the code, which an addition may break."""
SHORT = "not (slow or heavy or benchmark)"
UNTOUCHED = (
    *("agrees_with_the_code", "docstrings", "python_blocks", "yaml_blocks", "example_of_the_package"),
    *(f"code[{name}.svg]" for name in ("animation", "impact_damping", "paper", "transmissibility")),
)
"""Parts of names of their tests that run examples and the shipped rig: no further file can break them."""
PROSE = "import sys; from tools.prose_lint import findings; print(*findings(sys.argv[1:]))"
DRAWN = re.compile(r"^make figures ARGS=(\S+\.svg)", re.MULTILINE)
GENERATED = {str(path.relative_to(ROOT)) for path in generated()}


@attrs.frozen
class Recipe:
    """Section of the page.

    Attributes:
        files: content of the files that it writes, by path.
        most: number of files that its table allows.
        common: tests that must include the new part by themselves.
        chosen: words, one of which must be in the name of a test that is run here.
        passed: minimum number of passed tests, with its own.
        seen: generated files, and the text that they must contain.
    """

    title: str
    most: int
    common: str
    chosen: tuple[str, ...]
    passed: int
    seen: dict[str, str]

    @property
    def files(self) -> dict[str, str]:
        page = recipes.PAGE.read_text(encoding="utf-8")
        return recipes.files(page.partition(f"\n## {self.title}\n")[2].partition("\n## ")[0])


RECIPES = (
    Recipe(
        "A contact law",
        2,
        "test/impact_rig/physics/test_contact_laws.py",
        ("my_law",),
        12,
        {
            "config/nominal.yaml": "my_law, restitution",
            "docs/explanation/physics.md": "| `my_law` | 2(1 − e) | 0.526 |",
            "docs/reference/configuration.md": "my_law, restitution",
        },
    ),
    Recipe(
        "A contact law of another shape",
        2,
        "test/impact_rig/physics/test_contact_laws.py",
        ("linear_hysteretic",),
        12,
        {
            "config/nominal.yaml": "linear_stiffness_n_m: 5000000.0  # N/m",
            "docs/explanation/physics.md": "| `linear_hysteretic` |",
            "docs/reference/configuration.md": "`contact.linear_stiffness_n_m`",
        },
    ),
    Recipe(
        "An instrument",
        3,
        "test/impact_rig/instruments/test_registry.py",
        ("force", "optional", "folder"),
        7,
        {
            "config/nominal.yaml": "force:\n        present: false  # -; assumed: ",
            "docs/reference/interface.md": "| `barrier_force` | WrenchStamped | rig |",
        },
    ),
    Recipe(
        "An analysis with a topic",
        3,
        "test/impact_rig_studies/nodes/test_interface.py",
        ("rms",),
        3,
        {"docs/reference/interface.md": "### `acceleration_rms`"},
    ),
)


@attrs.frozen
class Copy:
    """Copy of the repository, as a developer has it."""

    root: Path

    def run(self, *arguments: str) -> str:
        """Run Python in the copy, which includes the library of kernels."""
        environment = {**os.environ, "PYTHONPATH": str(self.root)}
        done = subprocess.run(
            [sys.executable, *arguments], cwd=self.root, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{' '.join(arguments)}\n{done.stdout[-6000:]}\n{done.stderr[-6000:]}"
        return done.stdout

    def state(self) -> dict[str, str]:
        """Return a digest of each file in the copy."""
        files = (path for path in self.root.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
        return {str(path.relative_to(self.root)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture
def copy(tmp_path: Path) -> Copy:
    root = tmp_path / "checkout"
    for name in (*doc_paths.files(), ".github/workflows/ci.yaml"):
        if name != ".git" and not name.startswith(".coverage") and "__pycache__" not in name:
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, root / name)
    for folder in [root, *(path for path in root.rglob("*") if path.is_dir())]:
        if (compiled := ROOT / folder.relative_to(root) / "__pycache__").is_dir():  # valid, as times are copied
            (folder / "__pycache__").mkdir()
            for path in compiled.glob("*.pyc"):
                with contextlib.suppress(FileNotFoundError):  # another test may be writing it
                    shutil.copy2(path, folder / "__pycache__" / path.name)
    return Copy(root)


@pytest.mark.ros
@pytest.mark.timeout(900)  # in a fresh clone it may be the first to compile
@pytest.mark.parametrize(
    "chosen",
    [RECIPES, *(pytest.param((recipe,), marks=pytest.mark.slow) for recipe in RECIPES)],
    ids=lambda chosen: " and ".join(recipe.title for recipe in chosen),
)
def test_each_recipe_is_the_complete_change(chosen: tuple[Recipe, ...], copy: Copy):
    before = copy.state()
    files = {path: content for recipe in chosen for path, content in recipe.files.items()}
    for path, content in files.items():
        assert not (copy.root / path).exists(), f"{path}: a recipe adds files, it edits none"
        (copy.root / path).write_text(content, encoding="utf-8")
    copy.run("-m", "tools.generate")
    drawings = DRAWN.findall(recipes.PAGE.read_text(encoding="utf-8"))
    copy.run("-m", "tools.figures", *drawings)
    after = copy.state()
    changed = {path for path in {*before, *after} if before.get(path) != after.get(path)}
    assert changed - GENERATED - {f"docs/images/{name}" for name in drawings} == set(files)
    own = {path for path in files if path.startswith("test/")}
    words = " or ".join(word for recipe in chosen for word in recipe.chosen)
    names = " or ".join([*(Path(path).name for path in own), f"(({words}) and not 0.6 and not 0.8)"])
    common = {recipe.common for recipe in chosen}
    ran = copy.run("-m", "pytest", "-q", "-rA", "-p", "no:cacheprovider", *own, *common, "-k", names)
    passed = re.findall(r"^PASSED (.+)", ran, re.MULTILINE)
    for recipe in chosen:
        assert len(recipe.files) <= recipe.most
        for path, text in recipe.seen.items():
            assert text in (copy.root / path).read_text(encoding="utf-8"), path
        of_it = [test for test in passed if test.partition("::")[0] in recipe.files]
        assert of_it, "the recipe has a test of its own"
        of_it += [test for test in passed if test.startswith(recipe.common) and any(w in test for w in recipe.chosen)]
        assert len(of_it) >= recipe.passed, f"{recipe.title} has not joined the common tests\n{ran}"
    words = ["-m", SHORT, "-k", f"not ({' or '.join(UNTOUCHED)})"]
    copy.run("-m", "pytest", "-q", "-p", "no:cacheprovider", *words, *OF_PAGES)
    copy.run("-m", "ruff", "check", *files)
    copy.run("-m", "ruff", "format", "--check", *files)
    assert copy.run("-c", PROSE, *(path for path in changed if path.endswith((".py", ".md", ".yaml")))) == "\n"
