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
"""`python -m benchmarks [PART]`: benchmarks, whose figures are merged into build/bench.json."""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import json
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

PARTS = (
    "start",
    "physics",
    "instruments",
    "stream",
    "analysis",
    "recording",
    "campaign",
    "map",
    "live",
    "testing",
    "lab",
)
RESULTS = Path("build") / "bench.json"


def main() -> int:
    """Run the named parts, or all that exist; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=("all", *PARTS), default="all", help="parts to run (default: all)")
    chosen = parser.parse_args().parts
    wanted = PARTS if "all" in chosen else chosen
    console = Console()
    figures: dict[str, float] = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    for part in wanted:
        if importlib.util.find_spec(f"benchmarks.{part}") is None:
            continue
        console.rule(part)
        measured = importlib.import_module(f"benchmarks.{part}").run()
        figures.update(measured)
        table = Table()
        table.add_column("figure")
        table.add_column("value", justify="right")
        for key, value in measured.items():
            table.add_row(key, f"{value:.4g}" if isinstance(value, float) else str(value))
        console.print(table)
        RESULTS.parent.mkdir(exist_ok=True)
        RESULTS.write_text(json.dumps(figures, indent=2) + "\n")
    console.print(f"all figures so far: {RESULTS}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
