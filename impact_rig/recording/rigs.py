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
"""Rigs in a recording: their namespaces, and the full names of their topics.

A topic belongs to a rig if its name is the rig's namespace followed by the full relative name of a topic. The last part
of the name alone is not enough: `/rig/plot/envelope/laser` is not the monitor `laser`, and `/rig/truth/impacts` is not
`impacts`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from impact_rig import topics
from impact_rig.errors import RecordingError
from impact_rig.names import RIG_OPTION

_RELATIVE = sorted((topic for topic in topics.COMMON if not topic.name.startswith("/")), key=lambda one: -len(one.name))


def prefix_of(name: str, topic: topics.Topic) -> str | None:
    """Return the part of a full topic name before the relative name of `topic`, such as `/rig/` of `/rig/daq/scan`.

    The result is empty if `name` is the relative name itself, and None if `name` is not a name of this topic.
    """
    if name == topic.name:
        return ""
    return name.removesuffix(topic.name) if name.endswith(f"/{topic.name}") else None


def prefixes(types: Mapping[str, str]) -> tuple[str, ...]:
    """Return the topic prefix of each rig in a recording, such as `/rig/`, in alphabetical order.

    A rig is found by its topic `daq/scan`. If some of the topics with this relative name carry tables, only these
    topics count. In a recording without `daq/scan`, every topic whose name ends with a relative name of
    `impact_rig.topics` indicates a rig. If several relative names fit, the longest one counts.

    Args:
        types: type of each recorded topic, by full name.
    """
    scans = {name: prefix for name in types if (prefix := prefix_of(name, topics.SCAN)) is not None}
    tables = {prefix for name, prefix in scans.items() if types[name] == topics.TABLE}
    if scans:
        return tuple(sorted(tables or set(scans.values())))
    return tuple(sorted({found for name in types if (found := _longest(name)) is not None}))


def _longest(name: str) -> str | None:
    found = (prefix_of(name, topic) for topic in _RELATIVE)
    return next((prefix for prefix in found if prefix is not None), None)


def namespace(prefix: str) -> str:
    """Return the namespace of a topic prefix as users write it: `/rig` for `/rig/`, and `/` for the root."""
    return prefix.rstrip("/") or "/"


def choose(known: Iterable[str], wanted: str | None, where: object) -> str:
    """Return the topic prefix of the requested rig of a recording, such as `/rig/`.

    Args:
        known: prefixes of the rigs in a recording.
        wanted: namespace, with or without slashes around it. None means the only rig; if the recording has no rig, the
            result is then `/`.
        where: path of the recording, for the error.

    Raises:
        RecordingError: the recording has no such rig, or has several and none was chosen.
    """
    found = list(known)
    names = ", ".join(map(namespace, found)) or "none"
    if wanted is not None:
        chosen = [prefix for prefix in found if prefix.strip("/") == wanted.strip("/")]
        if not chosen:
            raise RecordingError(f"no rig {wanted!r} in {where}; there are: {names}")
        return chosen[0]
    if len(found) > 1:
        raise RecordingError(
            f"{where} holds several rigs: {names}; choose one with {RIG_OPTION} NAMESPACE (in Python rig=NAMESPACE)"
        )
    return found[0] if found else "/"
