# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""`python -m tools.website`: build the website into build/site; a warning is an error."""

from __future__ import annotations

import argparse
import contextlib
import functools
import http.server
import logging
import os
import sys
import threading
from collections.abc import Iterator
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


class _Quiet(http.server.SimpleHTTPRequestHandler):
    """Says nothing of what was asked for."""

    def log_message(self, *_: object) -> None:
        """Keep silent."""


@contextlib.contextmanager
def served(site: Path) -> Iterator[str]:
    """Show a built site to this machine, and give its address."""
    handler = functools.partial(_Quiet, directory=str(site))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, name="website")
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/"
        finally:
            server.shutdown()
            thread.join()


def main() -> None:
    """Build, say where, and exit 1 after a warning."""
    parser = argparse.ArgumentParser(prog="python -m tools.website", description=__doc__)
    parser.add_argument("--site", type=Path, default=ROOT / "build" / "site", help="directory (default: build/site)")
    parser.add_argument("--serve", action="store_true", help="show it to this machine, with its search, until Ctrl-C")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(message)s")
    site = build(arguments.site)
    sys.stdout.write(f"{site / 'index.html'}\n")
    if arguments.serve:
        with served(site) as address, contextlib.suppress(KeyboardInterrupt):
            sys.stdout.write(f"{address}\n")
            sys.stdout.flush()
            threading.Event().wait()


if __name__ == "__main__":
    main()
