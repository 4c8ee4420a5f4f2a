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
"""Tests that a change can reach: from `git diff`, along the references of each Python file to others.

A file reaches every file that names it: by import, by module name in a string (`python -m impact_rig.nodes`), by file
name (`"hostile.py"`, `"nominal.yaml"`) or, if it is not a module, by a folder of its path. This is at least what is
executed. A public name such as `impact_rig.simulate` stands for the module that defines it, and a page for the code in
it. A file that is not named anywhere reaches everything.
"""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterable
from pathlib import Path

from tools.syntax_trees import walk

ROOT = Path(__file__).parents[2]
FOLDERS = (
    "impact_rig", "impact_rig_studies", "impact_rig_lab", "qualification", "tools", "fuzz", "benchmarks", "examples",
    "launch", "test",
)  # fmt: skip
EVERYTHING = (
    "requirements", "pyproject.toml", "setup.py", "setup.cfg", "package.xml", "Makefile",
    "test/conftest.py", "test/kits/reach.py", "test/kits/measured.py", "tools/lines_passed/lines_passed.py",
    "tools/syntax_trees.py", "impact_rig/client/processes.py",
)  # fmt: skip
"""Files that every test depends on: the environment, the way tests are run, and what each of them gets."""
COMMAND_LINE = "impact_rig/cli/main.py"
"""It loads the entry points of setup.py, which name the modules of the commands."""
PUBLIC = "impact_rig/__init__.py"
"""Every module imports it. It loads the module of a public name when the name is used."""
OUTSIDE = ("docs/", "test/", "README", "CONTRIBUTING", "CHANGELOG", ".")
"""Paths that are not installed with the package, which therefore cannot read them."""
MODULE = re.compile(r"\b(?:impact_rig(?:_studies|_lab)?|qualification|tools|fuzz|benchmarks|kits)(?:\.\w+)*\b")
PUBLIC_NAMES = re.compile(r"\bfrom impact_rig import \(?([\w,\s]+|\*)")
FILE = re.compile(r"\b(?!__|conftest)\w+\.py\b")
PAGE = re.compile(r"\b\w+\.(?:md|ipynb)\b")
CODE = re.compile(r"^```(?:python|pycon).*?^```|\A\{.*", re.MULTILINE | re.DOTALL)
"""Python code in a page, or a whole notebook."""
REMEDY = re.compile(r"\brun `[^`]+`")
"""Command in a message, which the user runs, not the file that contains it."""
BY_NAME = re.compile(r"\b(?:import_module|lazily|iter_modules)\(")
"""Modules that load others by name may load every module of their package."""


def changed(since: str) -> list[str]:
    """Return the paths that differ from a commit, with changes of the working tree and files that git does not know.

    Raises:
        subprocess.CalledProcessError: this is no checkout, or there is no such commit.
    """
    found: list[str] = []
    for words in (["diff", "--name-only", "--no-renames", since, "--"], ["ls-files", "--others", "--exclude-standard"]):
        done = subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True, text=True)
        found += done.stdout.splitlines()
    return found


class Reach:
    """Graph of the files in a checkout that name each other.

    Args:
        root: of the checkout.
    """

    def __init__(self, root: Path = ROOT) -> None:
        self._texts = {
            str(path.relative_to(root)): path.read_text(encoding="utf-8")
            for folder in FOLDERS
            for path in (root / folder).rglob("*.py")
        }
        self._files = {name: path for path in self._texts for name in _called(path)}
        self._by_file: dict[str, set[str]] = {}
        for path in self._texts:
            self._by_file.setdefault(Path(path).name, set()).add(path)
        self._pages: dict[str, str] = {}
        for page in [*root.glob("*.md"), *root.glob("docs/**/*.md"), *root.glob("examples/*.ipynb")]:
            code = "\n".join(CODE.findall(page.read_text(encoding="utf-8")))
            self._pages[page.name] = self._pages.get(page.name, "") + code
        public = ast.walk(ast.parse(self._texts.get(PUBLIC, "")))
        imports = [node for node in public if isinstance(node, ast.ImportFrom)]
        self._homes = {f"impact_rig.{alias.name}": f"{node.module}" for node in imports for alias in node.names}
        self._strings: dict[str, str] = {}
        setup = root / "setup.py"
        points = re.findall(r"= ([\w.]+):", setup.read_text(encoding="utf-8")) if setup.exists() else []
        self._commands = {self._files[name] for name in points if name in self._files}
        self._used = {path: self._uses(path) for path in self._texts}

    def files(self, paths: Iterable[str]) -> set[str] | None:
        """Return the Python files, with tests, that changes of `paths` can reach; None means all files."""
        found: set[str] = set()
        for path in paths:
            first = {path} & self._texts.keys() or self._readers(path)
            if path.startswith(EVERYTHING) or not first:
                return None
            found |= first
        waiting = found
        while waiting:
            waiting = {user for user, used in self._used.items() if used & waiting} - found
            found |= waiting
        return found

    def _uses(self, path: str) -> set[str]:
        """Return the files that a Python file names."""
        if path == PUBLIC:
            return set()
        names, strings, bases = set[str](), list[str](), set[ast.expr]()
        said = set[ast.expr]()  # docstrings
        for node in walk(ast.parse(self._texts[path])):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                names.add(f"{node.value.id}.{node.attr}")
                bases.add(node.value)
            elif isinstance(node, ast.Name) and node.id == "impact_rig" and node not in bases:
                names.add("impact_rig.*")  # for `getattr`
            elif isinstance(node, ast.Import):
                names |= {f"{alias.name}.*" if alias.asname else alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
            elif isinstance(node, ast.Expr):
                said.add(node.value)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in said:
                strings.append(node.value)
        text = self._strings[path] = REMEDY.sub("", "\n".join(strings))
        text += "".join(f"\n{self._pages.get(name, '')}" for name in set(PAGE.findall(text)))
        names |= set(MODULE.findall(text))
        names |= {f"impact_rig.{name}" for words in PUBLIC_NAMES.findall(text) for name in re.split(r"[,\s]+", words)}
        names |= {home for name, home in self._homes.items() if name in names or "impact_rig.*" in names}
        parts = [name.split(".") for name in names]
        names = {".".join(each[: count + 1]) for each in parts for count in range(len(each))}
        found = {self._files[name] for name in names & self._files.keys()}
        found |= {self._files[f"{name}.__main__"] for name in names if f"{name}.__main__" in self._files}
        for name in set(FILE.findall(text)):
            found |= self._by_file.get(name, set())
        if path == COMMAND_LINE:
            found |= self._commands
        folder = str(Path(path).parent)
        if BY_NAME.search(self._texts[path]):
            found |= {other for other in self._texts if other.startswith(f"{folder}/")}
        if path.startswith("test/"):
            conftests = {f"{above}/conftest.py" for above in Path(path).parents}
            found |= conftests & self._texts.keys() - {"test/conftest.py"}
        return found - {path}

    def _readers(self, path: str) -> set[str]:
        """Return the Python files that name a file which is not Python, or a folder (no package) that contains it."""
        folders = (above for above in Path(path).parents if above.name and f"{above}/__init__.py" not in self._strings)
        words = "|".join(re.escape(name) for name in {Path(path).name, *(above.name for above in folders)} - {"test"})
        named = re.compile(rf"(?:^|/)(?:{words})(?:$|/)", re.MULTILINE)
        outside = path.startswith(OUTSIDE)
        return {
            user
            for user, text in self._strings.items()
            if named.search(text) and not (outside and user.startswith("impact_rig"))
        }


def _called(path: str) -> set[str]:
    """Return the module names of a Python file."""
    parts = Path(path).with_suffix("").parts
    parts = parts[1:] if parts[0] == "test" else parts
    return {".".join(parts[:-1] if parts[-1] == "__init__" else parts)}
