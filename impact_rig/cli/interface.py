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
"""Command `impact-rig interface`: prints topics, services and parameters of this version, or changes since another."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any  # what JSON holds

from impact_rig.cli.terminal import Console, TextTable, tell_json
from impact_rig.errors import ConfigError
from impact_rig.system import files

DOCUMENT = Path(__file__).parents[1] / "interface.json"
"""Path of this version's interface document; `make generate` writes it from topics, services and parameters."""
MAX_BYTES = 5_000_000
_MALFORMED = "{} is not a document of `impact-rig interface --json`: write it again with the earlier version"
CLIENTS = ("client", "peers")  # publishers of the rig's inputs

Row = dict[str, Any]


def run_interface(arguments: argparse.Namespace) -> int:
    """Run `impact-rig interface`: print the interface of this version, or with `--against` the changes since another.

    Return exit code 1 if a change breaks clients of the other version, else 0.
    """
    present = read(DOCUMENT)
    if not arguments.against:
        if arguments.json:
            tell_json(present)
        else:
            _show(present)
        return 0
    try:
        breaks, other = differences(read(arguments.against), present)
    except (AttributeError, KeyError, TypeError) as error:
        raise ConfigError(_MALFORMED.format(arguments.against)) from error
    if arguments.json:
        tell_json({"breaks": breaks, "other": other})
    else:
        console = Console()
        for text in breaks:
            console.print(f"breaks clients: {text}", style="red")
        for text in other:
            console.print(text)
        console.print(f"{len(breaks)} differences break a client of the older version, {len(other)} do not")
    return 1 if breaks else 0


def _show(document: Mapping[str, Any]) -> None:
    table = TextTable(left=("topic or service", "type", "from"))
    for name, topic in document["topics"].items():
        table.add_row(name, topic["type"].split("/")[-1], topic["publisher"])
    for name, service in document["services"].items():
        table.add_row(name, service["type"].split("/")[-1], "service")
    counts = ", ".join(f"{len(rows)} of {node}" for node, rows in document["parameters"].items())
    Console().print(table, f"number of parameters: {counts}; --json prints the whole interface", sep="\n")


def read(path: Path) -> dict[str, Any]:
    """Read an interface document, as written by `impact-rig interface --json`.

    The members of the JSON object are not checked.

    Raises:
        ConfigError: the file cannot be read or does not hold a JSON object; the message names the file.
    """
    try:
        return {**json.loads(files.read_bytes(path, MAX_BYTES))}
    except OSError as error:
        raise ConfigError(f"cannot read the interface document: {files.reason_unreadable(error, path)}") from error
    except (ValueError, TypeError, RecursionError) as error:
        raise ConfigError(_MALFORMED.format(path)) from error


def differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """Compare two interface documents, and return the changes.

    Args:
        old: document of the version for which a client was written.
        new: document of the version with which the client is used.

    Returns:
        The changes that break such a client, and all other changes, each as one line of text.

    Raises:
        AttributeError, KeyError, TypeError: `old` or `new` is not an interface document.
    """
    before, after = dict(_rows(old)), dict(_rows(new))
    gone = [name for name in before if name not in after and _whole(name) not in set(before) - set(after)]
    breaks = [f"{name} was removed" for name in gone]
    other: list[str] = []
    for name, row in after.items():
        if name not in before:
            if _whole(name) not in set(after) - set(before):
                needed = row["taken"] and row.get("required")
                (breaks if needed else other).append(f"{name} is new" + " and required" * bool(needed))
            continue
        for key in dict.fromkeys((*before[name], *row)):
            was, now = before[name].get(key), row.get(key)
            if was != now and key not in ("doc", "taken"):
                bad = key not in _BREAKS or _BREAKS[key](was, now, row)
                (breaks if bad else other).append(f"{name}: {key} was {_shown(was)}, is {_shown(now)}")
    return breaks, other


def _rows(document: Mapping[str, Any]) -> Iterator[tuple[str, Row]]:
    """Yield name and properties of each topic, column, service and parameter of an interface document.

    The additional property `taken` is true for topics that clients publish, and for all services and parameters.
    """
    for name, topic in document["topics"].items():
        taken = topic["publisher"] in CLIENTS
        yield f"topic {name}", {**{key: value for key, value in topic.items() if key != "columns"}, "taken": taken}
        for column, about in topic["columns"].items():
            yield f"topic {name}, column {column}", {**about, "taken": taken}
    for name, service in document["services"].items():
        yield f"service {name}", {**service, "taken": True}
    for node, parameters in document["parameters"].items():
        for name, about in parameters.items():
            yield f"parameter {name} of {node}", {**about, "taken": True}


def _whole(name: str) -> str | None:
    """Return the topic (`topic T`) of a column with the name `topic T, column C`; None for any other name."""
    topic, column, _ = name.partition(", column ")
    return topic if column else None


def _shown(value: object) -> str:
    return "not stated" if value is None else json.dumps(value, ensure_ascii=False)


def _offers(less: str, more: str) -> Callable[[Any, Any, Row], bool]:
    """Return a function for `_BREAKS` that says whether a changed quality of service breaks clients.

    DDS does not connect a subscriber that requests more than its publisher offers (OMG DDS 1.4, 2.2.3). Subscribers of
    a topic of the rig therefore break if the new value is `less`. Publishers of an input of the rig break if it is
    `more`.
    """
    return lambda _was, now, row: bool(now == more if row["taken"] else now in (less, None))


def _reaches(sign: float) -> Callable[[Any, Any, Row], bool]:
    """Return a function for `_BREAKS` that says whether a changed bound breaks clients.

    A bound of the rig's inputs breaks clients if the rig accepts fewer values. A bound of published values does not.
    The value None means no bound.

    Args:
        sign: +1 for an upper bound, -1 for a lower one.
    """

    def narrower(was: float | None, now: float | None, row: Row) -> bool:
        end = sign * math.inf
        return row["taken"] and sign * (end if now is None else now) < sign * (end if was is None else was)

    return narrower


_BREAKS: dict[str, Callable[[Any, Any, Row], bool]] = {
    "publisher": lambda was, now, _: (was in CLIENTS) != (now in CLIENTS),
    "reliability": _offers("best effort", "reliable"),
    "durability": _offers("volatile", "transient local"),
    # late subscribers receive fewer messages; no client can rely on the number kept for a slow one
    "depth": lambda was, now, row: (
        row.get("durability") == "transient local" and not row["taken"] and was is not None and (now or 0) < was
    ),
    **dict.fromkeys(("required", "start_only"), lambda _was, now, _: bool(now)),
    "least": _reaches(-1.0),
    "most": _reaches(1.0),
    **dict.fromkeys(("least_open", "most_open", "whole"), lambda _was, now, row: bool(row["taken"] and now)),
    "choices": lambda was, now, row: now is not None and (row["taken"] if was is None else not set(was) <= set(now)),
}
"""Functions that return whether a change of a property breaks clients, by name of the property.

Arguments are the value before, the value after, and the properties after (`Row`). A change of a property that is not
listed here always breaks clients.
"""
