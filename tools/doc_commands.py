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
"""Commands in documents, each held against the program's own parser: none is there that it does not know."""

from __future__ import annotations

import argparse
import importlib.util
import re
import shlex
from collections.abc import Callable, Iterator

from impact_rig.cli.main import command_line
from tools.doc_paths import ROOT, exists


def commands(text: str) -> Iterator[list[str]]:
    """Yield the words of each command in lines of shell, without assignments in front and words of loops."""
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
    """Yield what is wrong with a command; one in running text need not be `whole`."""
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
    parser = command_line()
    choices = next(action.choices for action in parser._actions if isinstance(action.choices, dict))
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


def _make(words: list[str], _: bool) -> str | None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for word in words:
        variable = re.match(r"[A-Z]+(?==)", word)
        if variable and f"$({variable[0]})" not in makefile:
            return f"the Makefile has no variable {variable[0]}"
        if not variable and word != "…" and not re.search(rf"^{re.escape(word)}:.*##", makefile, re.MULTILINE):
            return f"the Makefile has no target {word}"
    return None


def _python(words: list[str], _: bool) -> str | None:
    if words[:1] == ["-m"]:
        return None if importlib.util.find_spec(words[1]) else f"there is no module {words[1]}"
    return None if exists(words[0]) else f"there is no {words[0]}"


def _pytest(words: list[str], _: bool) -> str | None:
    plugin = (ROOT / "impact_rig" / "testing" / "plugin.py").read_text(encoding="utf-8")
    unknown = [word for word in words if word.startswith("--rig") and f'"{word}"' not in plugin]
    return f"the plugin has no {unknown[0]}" if unknown else None


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
    interface = (ROOT / "docs" / "interface.md").read_text(encoding="utf-8")  # itself held against the code by a test
    if words[0] in {"topic", "service"}:
        for name in (word.removeprefix("/rig/") for word in words if word.startswith("/rig/")):
            if f"`{name}`" not in interface:
                return f"docs/interface.md has no {words[0]} {name}"
    if words[:2] == ["param", "set"] and f"`{words[3]}`" not in interface:
        return f"docs/interface.md has no parameter {words[3]}"
    return None


PROGRAMS: dict[str, Callable[[list[str], bool], str | None]] = {
    "impact-rig": _impact_rig, "make": _make, "python": _python, "pytest": _pytest, "ros2": _ros2,
}  # fmt: skip
