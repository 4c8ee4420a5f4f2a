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
"""Reference of the command line: arguments, options and examples of each command, read from the parsers."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from impact_rig.cli.main import PROGRAM, command_line
from tools.generate.markdown import table


def reference() -> str:
    """Return a section for each command and, under it, for each of its subcommands."""
    return "\n".join(_sections(command_line(), PROGRAM, 2))


def _sections(parser: argparse.ArgumentParser, name: str, level: int) -> Iterator[str]:
    """Yield the sections of the subcommands of a parser."""
    for action in parser._actions:  # the public interface of argparse gives no access to them
        if not isinstance(action, argparse._SubParsersAction):
            continue
        helps = {choice.dest: choice.help or "" for choice in action._choices_actions}
        for word, sub in action.choices.items():
            title = f"{name} {word}"
            description = " ".join((sub.description or helps.get(word, "")).split())
            yield f"{'#' * level} {title}\n\n{_escaped(description)}\n"
            rows = [(_signature(one), _help(one)) for one in sub._actions if _is_shown(one)]
            if rows:
                yield table(("argument", "meaning"), rows)
            if sub.epilog:
                yield f"```text\n{sub.epilog.strip()}\n```\n"
            yield from _sections(sub, title, level + 1)


def _is_shown(action: argparse.Action) -> bool:
    hidden = isinstance(action, argparse._HelpAction | argparse._SubParsersAction)
    return not hidden and action.help is not argparse.SUPPRESS


def _signature(action: argparse.Action) -> str:
    """Return an argument as it is typed, `--scan-rate HZ`."""
    if action.nargs == 0:
        value = ""
    elif action.choices is not None:
        value = f"{{{','.join(map(str, action.choices))}}}"
    else:
        value = (
            action.metavar if isinstance(action.metavar, str) else " ".join(action.metavar or (action.dest.upper(),))
        )
    value += " …" if action.nargs in ("*", "+") else ""
    return f"`{' '.join(filter(None, [', '.join(action.option_strings), value]))}`"


def _help(action: argparse.Action) -> str:
    """Return the help with its defaults filled in."""
    return _escaped(" ".join(((action.help or "") % {**vars(action), "prog": PROGRAM}).split()))


def _escaped(text: str) -> str:
    """Return text with the characters escaped that Markdown would interpret outside of code."""
    parts = text.split("`")
    return "`".join(part if k % 2 else part.replace("*", r"\*").replace("<", r"\<") for k, part in enumerate(parts))
