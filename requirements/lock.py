# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Renew the exact versions in common.txt and wheels.txt: `python3.11 requirements/lock.py`, then run the tests.

Run it with the lowest supported Python: versions chosen there also exist for the higher ones, not the other way round.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
HEADER = "# Written by lock.py from direct.txt: exact versions, dependencies of dependencies included.\n"
PIP_OPTIONS = "--only-binary :all:\n--no-binary empy\n"  # nothing is compiled; empy exists as source only, pure Python


def resolve() -> dict[str, str]:
    """Return name -> version of everything direct.txt needs, into an empty environment."""
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed", "--report", "-"]
    options = [*PIP_OPTIONS.split(), "--requirement", str(HERE / "direct.txt")]
    report = subprocess.run([*command, *options], check=True, capture_output=True, text=True).stdout  # noqa: S603  # own arguments
    found = (item["metadata"] for item in json.loads(report)["install"])
    return {normalised(item["name"]): item["version"] for item in found}


def normalised(name: str) -> str:
    """Return the one spelling of a package name (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def main() -> None:
    """Write both files."""
    versions = resolve()
    # an apt-installed Jazzy brings its own of these: its message classes are compiled against numpy 1.26
    ros = {name for name in versions if name.startswith("ros-")} | {"numpy", "empy", "lark", "lark-parser"}
    for file, names in (("common.txt", versions.keys() - ros), ("wheels.txt", ros & versions.keys())):
        pins = "".join(f"{name}=={versions[name]}\n" for name in sorted(names))
        (HERE / file).write_text(HEADER + PIP_OPTIONS + pins, encoding="utf-8")


if __name__ == "__main__":
    main()
