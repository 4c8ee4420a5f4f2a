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
"""`python -m tools.website`: build of the website in build/site; a warning is an error."""

from __future__ import annotations

import argparse
import logging
import os
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
os.environ.setdefault("NO_MKDOCS_2_WARNING", "1")  # advertisement of the theme's authors on every build


def build(site: Path = ROOT / "build" / "site") -> Path:
    """Build the site into a directory and return it.

    Raises:
        mkdocs.exceptions.Abort: there were warnings.
    """
    from mkdocs.commands.build import build as build_site  # noqa: PLC0415  # after the environment is set
    from mkdocs.config import load_config  # noqa: PLC0415

    config = load_config(str(ROOT / "mkdocs.yml"), site_dir=str(site))
    build_site(config)
    return site


def main() -> None:
    """Build the site, print its directory, and exit with 1 after a warning."""
    parser = argparse.ArgumentParser(prog="python -m tools.website", description=__doc__)
    parser.add_argument("--site", type=Path, default=ROOT / "build" / "site", help="directory (default: build/site)")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(message)s")
    sys.stdout.write(f"{build(arguments.site) / 'index.html'}\n")


if __name__ == "__main__":
    main()
