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
"""Installer of all recipes of docs/how-to/extending.md into this checkout: `python -m tools.recipes`."""

from __future__ import annotations

import argparse
import re

from tools.doc_paths import ROOT

PAGE = ROOT / "docs" / "how-to" / "extending.md"


def notice() -> str:
    """Return the lines of the licence at the start of every Python file, which the page leaves out."""
    return (ROOT / "setup.py").read_text(encoding="utf-8").partition('"""')[0]


def files(section: str) -> dict[str, str]:
    """Return the files that a section of the page describes: content by path."""
    return {
        path: notice() + content for path, content in re.findall(r"```\w+ title=(\S+)\n(.*?)```", section, re.DOTALL)
    }


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    for name, content in files(PAGE.read_text(encoding="utf-8")).items():
        with (ROOT / name).open("x", encoding="utf-8") as file:
            file.write(content)
