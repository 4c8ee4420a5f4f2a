# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The layouts of plotters in `config/`, for rigs in any namespace: the files themselves are for `/rig`."""

from __future__ import annotations

import re
from pathlib import Path

from impact_rig.errors import ConfigError
from impact_rig.system.resources import config_dir

NAMES = ("foxglove/rig.json", "plotjuggler/rig.xml")
"""The layouts, below `config/`; both name topics as texts in double quotes."""
_NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)*")
_TOPIC = re.compile(r'"/rig/')


def write_layouts(directory: Path, namespace: str) -> list[Path]:
    """Write every layout for a namespace (`/` or nothing: none, as in runs of the demo) and return their paths.

    Raises:
        ConfigError: no such namespace can be.
        OSError: a file is there already, or cannot be written.
    """
    place = "/" + namespace.strip("/") if namespace.strip("/") else ""
    if not _NAMESPACE.fullmatch(place):
        raise ConfigError(f"a namespace has names of letters, digits and _ with / between, got {namespace!r}")
    directory.mkdir(parents=True, exist_ok=True)
    written = []
    for name in NAMES:
        text = (config_dir() / name).read_text(encoding="utf-8")
        path = directory / f"{place.strip('/').replace('/', '_') or 'no_namespace'}{Path(name).suffix}"
        with path.open("x", encoding="utf-8") as stream:
            stream.write(_TOPIC.sub(f'"{place}/', text))
        written.append(path)
    return written
