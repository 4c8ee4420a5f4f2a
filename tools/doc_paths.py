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
"""Paths of the repository and names of its code in its documents: recognition of them, and checks that they exist."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("impact_rig", "impact_rig_studies", "impact_rig_lab")
MADE = {"build", "install", "log", "runs", "failed_runs"}
"""Folders that a checkout may have and the repository does not."""
NO_PATHS = {"impact_rig/topic", "impact_rig/losses", "impact_rig/recovered", "impact_rig/continues"}  # names of records
_PATH = re.compile(r"[\w.-]+(?:/[\w.-]+)*/?")
_ENDINGS = (".py", ".md", ".yaml", ".xml", ".json", ".toml", ".txt", ".rst", ".sh", ".c")


@cache
def files() -> tuple[str, ...]:
    """Return the paths of all files of the repository, relative to it."""
    folders = [path for path in ROOT.iterdir() if path.is_dir() and path.name not in MADE and path.name[0] != "."]
    found = [*(path for folder in folders for path in folder.rglob("*")), *ROOT.iterdir()]
    return tuple(path.relative_to(ROOT).as_posix() for path in found if path.is_file())


def is_path(text: str) -> bool:
    """Return whether a word looks like a file or folder of the repository."""
    if text in NO_PATHS or not _PATH.fullmatch(text):
        return False
    top, slash, _ = text.partition("/")
    below = bool(slash) and top not in MADE and any(name.startswith(f"{top}/") for name in files())
    return below or text.endswith((".py", ".md")) or (bool(slash) and top not in MADE and text.endswith(_ENDINGS))


def exists(text: str) -> bool:
    """Return whether such a file or folder exists; `nodes/topics.py` may stand for `impact_rig/topics.py`."""
    return (ROOT / text).exists() or any(name.endswith(f"/{text}") for name in files())


def is_dangling(text: str) -> bool:
    """Return whether a word is a dotted name of this package, module or parameter whose last part does not exist.

    A name such as `rig.save`, of a variable, is searched in the complete package.
    """
    name = re.match(r"([a-z_]\w*(?:\.\w+)+)(?:\(.*\))?$", text)
    if not name:
        return False
    first, _, below = name[1].partition(".")
    package = ROOT / (first if first in PACKAGES else PACKAGES[0])
    top, *rest = (below if first in PACKAGES else name[1]).split(".")
    if not rest:  # of the package itself: a module, or a public name
        return not (
            (package / top).exists() or (package / f"{top}.py").exists() or top in _words(package / "__init__.py")
        )
    if (package / f"{top}.py").is_file():
        where = [package / f"{top}.py"]
    elif top != "rig" and (package / top).is_dir():
        where = [path for path in (package / top).rglob("*") if path.suffix in (".py", ".js")]
    elif top == "rig":
        where = list(package.rglob("*.py"))
    else:
        sections = {name.partition(".")[0] for name in _parameters()}
        return top in sections and f"{top}.{rest[0]}" not in _parameters()
    known = {word for path in where for word in _words(path)} | {path.stem for path in where}
    known |= {path.name for path in (package / top).rglob("*") if path.is_dir()} | {"py", "md", "yaml"}
    return f"{top}.{rest[0]}" not in _parameters() and not known.issuperset(rest)


@cache
def _words(path: Path) -> frozenset[str]:
    return frozenset(re.findall(r"\w+", path.read_text(encoding="utf-8")))


@cache
def _parameters() -> frozenset[str]:
    text = (ROOT / "docs" / "reference" / "configuration.md").read_text(encoding="utf-8")
    return frozenset(re.findall(r"`([a-z_]+\.\w+)", text))
