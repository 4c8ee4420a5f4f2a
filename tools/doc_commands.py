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
"""Commands in documents, checked by the program's own parser."""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import re
import shlex
from collections.abc import Callable, Iterator
from functools import cache

from impact_rig.cli.main import command_line
from tools.doc_paths import ROOT, exists


def commands(text: str) -> Iterator[list[str]]:
    """Yield the words of each shell command, without preceding assignments and words of loops."""
    for line in text.replace("\\\n", " ").splitlines():
        words: list[str] = []
        lexer = shlex.shlex(line, posix=True, punctuation_chars=";&|")
        lexer.whitespace_split = True
        for word in (*lexer, ";"):
            if set(word) <= set(";&|"):
                if words and words[0] not in {"for", "done"}:
                    yield words
                words = []
            elif words or not re.fullmatch(r"\w+=.*|do|export|sudo", word):
                words.append(word)


def command_faults(words: list[str], *, whole: bool) -> Iterator[str]:
    """Yield the mistakes in a command; a command in running text need not be complete (`whole`)."""
    check = PROGRAMS.get(words[0])
    try:
        fault = check(words[1:], whole) if check else None
    except argparse.ArgumentError as error:
        fault = str(error)
    except IndexError:
        fault = "words are missing" if whole else None
    if fault:
        yield f"{shlex.join(words)}: {fault}"


def _impact_rig(words: list[str], whole: bool) -> str | None:
    choices = next(action.choices for action in _parser()._actions if isinstance(action.choices, dict))
    if words[:1] in (["--help"], ["--version"]):
        return None
    if not words or words[0] not in choices:
        return "no such subcommand"
    chosen: argparse.ArgumentParser = choices[words[0]]
    said: list[str] = []
    chosen.error = said.append  # instead of ending this process
    unknown = chosen.parse_known_args(words[1:])[1]
    said += [f"unrecognized arguments: {' '.join(unknown)}"] if unknown else []
    return next((text for text in said if whole or "are required" not in text), None)


@cache
def _parser() -> argparse.ArgumentParser:
    return command_line()


def _make(words: list[str], whole: bool) -> str | None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    given = {name: value for name, is_set, value in (word.partition("=") for word in words) if is_set}
    for variable in given:
        if f"$({variable})" not in makefile:
            return f"the Makefile has no variable {variable}"
    recipe = ""
    for target in (word for word in words if "=" not in word and word != "…"):
        found = re.search(rf"^{re.escape(target)}:.*##.*\n((?:\t.*\n)*)", makefile, re.MULTILINE)
        if found is None:
            return f"the Makefile has no target {target}"
        recipe = found[1]
    if (ros := given.get("ROS")) and not (ROOT / "requirements" / f"{ros}.txt").exists():
        return f"requirements/ has no ROS {ros}"
    if (part := given.get("ONLY")) and not (ROOT / "benchmarks" / f"{part}.py").exists():
        return f"benchmarks/ has no part {part}"
    return _options(recipe, shlex.split(given.get("ARGS", "")), whole)


def _options(recipe: str, words: list[str], whole: bool) -> str | None:
    """Check the words of ARGS with the parser of the program that a target starts with them."""
    line = next((line for line in recipe.splitlines() if "$(ARGS)" in line), "")
    if command := re.search(r"bin/impact-rig (.*?)\$\(ARGS\)", line):
        return _impact_rig([*command[1].split(), *words], whole)
    if "pytest" in recipe.lower():
        return _pytest(words, whole)
    module = re.search(r"(?:-m | )([\w./]+?)(?:\.py)? \$\(ARGS\)", line)
    path = ROOT / module[1].replace(".", "/") if module else ROOT
    files = (file for file in (path.with_suffix(".py"), *path.glob("*.py")) if file.is_file())
    source = "".join(file.read_text(encoding="utf-8") for file in files)
    named = [word.partition("=")[0] for word in words]  # an option, without the value that follows its =
    known = (word[0].isdigit() or f'"{word}"' in source or f"/{word}.py" in source for word in named)
    return next(
        (f"{path.name} has no {word}" for word, is_known in zip(words, known, strict=True) if not is_known), None
    )


def _python(words: list[str], _: bool) -> str | None:
    if words[:1] == ["-c"]:
        return None
    if words[:1] == ["-m"]:
        return None if importlib.util.find_spec(words[1]) else f"there is no module {words[1]}"
    return None if exists(words[0]) else f"there is no {words[0]}"


def _pytest(words: list[str], _: bool) -> str | None:
    files = ("impact_rig/testing/plugin.py", "test/conftest.py")
    plugins = "".join((ROOT / name).read_text(encoding="utf-8") for name in files)
    for before, word in itertools.pairwise(["", *words]):
        option = word.partition("=")[0]
        if option.startswith(("--rig", "--thorough", "--change")) and f'"{option}"' not in plugins:
            return f"the plugin has no {option}"
        if "/" in word and not exists(word):
            return f"there is no {word}"
        if before == "-k" and not _names_a_test(word):
            return f"no test has {word} in its name"
    return None


def _names_a_test(word: str) -> bool:
    paths = (ROOT / "test").rglob("test_*.py")
    return any(word in path.name or re.search(rf"^def test_\w*{word}", path.read_text("utf-8"), re.M) for path in paths)


def _ros2(words: list[str], whole: bool) -> str | None:
    if words[:2] == ["run", "impact_rig"]:
        if f'"{words[2]} = ' not in (ROOT / "setup.py").read_text(encoding="utf-8"):
            return f"setup.py has no program {words[2]}"
        return _impact_rig(words[3:], whole) if words[2] == "impact-rig" else None
    if words[:2] == ["launch", "impact_rig"]:
        file = ROOT / "launch" / words[2]
        if not file.exists():
            return f"there is no launch file {words[2]}"
        declared = re.findall(r'DeclareLaunchArgument\(\s*"(\w+)"', file.read_text(encoding="utf-8"))
        given = [word.partition(":=")[0] for word in words[3:] if ":=" in word]
        return next((f"{file.name} has no argument {name}" for name in given if name not in declared), None)
    interface, configuration = (  # tests compare both with the code
        (ROOT / "docs" / "reference" / f"{name}.md").read_text(encoding="utf-8")
        for name in ("interface", "configuration")
    )
    if words[0] in {"topic", "service"}:
        for name in (word.removeprefix("/rig/") for word in words if word.startswith("/rig/")):
            if f"`{name}`" not in interface:
                return f"docs/reference/interface.md has no {words[0]} {name}"
    if words[:2] == ["param", "set"] and f"`{words[3]}`" not in configuration:
        return f"docs/reference/configuration.md has no parameter {words[3]}"
    return None


PROGRAMS: dict[str, Callable[[list[str], bool], str | None]] = {
    "impact-rig": _impact_rig, "make": _make, "python": _python, "pytest": _pytest, "ros2": _ros2,
}  # fmt: skip
