# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The `.msg` text of a message type, read from the installed interfaces: what MCAP calls a `ros2msg` schema.

The text of the type itself, then each type it uses, however deep, once, after a line of 80 `=` and `MSG: package/Type`.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from impact_rig.errors import RecordingError

ENCODING = "ros2msg"

_SEPARATOR = "=" * 80
_NAME = re.compile(r"([A-Za-z]\w*)/(?:msg/)?([A-Za-z]\w*)")
_FIELD = re.compile(r"^[ \t]*([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]\n]*\])?[ \t]+[A-Za-z]\w*", re.MULTILINE)
_PRIMITIVE = re.compile(r"bool|byte|char|float(32|64)|u?int(8|16|32|64)|w?string")
_MAX_TYPES = 200  # no message of common_interfaces comes near; a circular or hostile definition does not run away


def interface_prefixes() -> tuple[Path, ...]:
    """Return where interfaces may be installed: the sourced ROS first, then this Python environment."""
    sourced = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return tuple(Path(prefix) for prefix in [*sourced, sys.prefix] if prefix)


def schema_text(type_name: str, prefixes: Sequence[Path] | None = None) -> str:
    """Return the schema of `type_name` (`package/msg/Type`), dependencies appended.

    Args:
        type_name: as ROS writes it; `package/Type` is understood too.
        prefixes: where to look for `share/<package>/msg/<Type>.msg`; None: `interface_prefixes()`.

    Raises:
        RecordingError: the type or one it uses is not installed, or the name is not a message type's.
    """
    where = interface_prefixes() if prefixes is None else tuple(prefixes)
    root = _short_name(type_name)
    seen = {root}
    parts: list[str] = []

    def append(name: str) -> None:
        package, kind = name.split("/")
        text = _read(package, kind, where, type_name)
        parts.append(text if not parts else f"{_SEPARATOR}\nMSG: {name}\n{text}")
        for used in sorted(_used_types(text, package)):
            if used not in seen:
                seen.add(used)
                if len(seen) > _MAX_TYPES:
                    raise RecordingError(f"{type_name} uses more than {_MAX_TYPES} message types")
                append(used)

    append(root)
    return "\n".join(parts)


def starts_with_header(type_name: str, schema: str) -> bool:
    """Return whether messages of this type begin with a `std_msgs/Header`, or are one."""
    if _short_name(type_name) == "std_msgs/Header":
        return True
    first = next(_fields(schema), "")
    return first in {"std_msgs/Header", "std_msgs/msg/Header", "Header"}


def _short_name(type_name: str) -> str:
    match = _NAME.fullmatch(type_name)
    if match is None:
        raise RecordingError(f"{type_name!r} is not the name of a message type, such as sensor_msgs/msg/PointCloud2")
    return f"{match[1]}/{match[2]}"


def _read(package: str, kind: str, prefixes: Sequence[Path], wanted_by: str) -> str:
    for prefix in prefixes:
        path = prefix / "share" / package / "msg" / f"{kind}.msg"
        try:
            return path.read_text(encoding="utf-8")
        except OSError:
            continue
    looked = ", ".join(str(prefix / "share") for prefix in prefixes) or "nowhere: no prefix is known"
    raise RecordingError(f"{wanted_by} is not installed: no {package}/msg/{kind}.msg in {looked}")


def _fields(text: str) -> Iterator[str]:
    for match in _FIELD.finditer(text):
        yield match[1]


def _used_types(text: str, package: str) -> set[str]:
    used = set()
    for name in _fields(text):
        if not _PRIMITIVE.fullmatch(name):
            used.add(_short_name(name) if "/" in name else f"{package}/{name}")
    return used
