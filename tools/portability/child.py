"""Record runs in this process and write their digests: one process, one mask.

    python -m tools.portability.child OUTPUT RUN... [--save DIRECTORY | --against DIRECTORY]

OUTPUT gets one line per topic; `--save` keeps the rows, `--against` says on stdout where they differ from kept ones.
"""

from __future__ import annotations

import argparse
import sys
import traceback
from pathlib import Path

import numpy as np

from tools.portability import digests
from tools.portability.runs import LONG, SHORT, Streams, known, record


def main() -> int:
    """Return 0 if every run could be recorded, whatever its bits."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("output", type=Path)
    parser.add_argument("runs", nargs="+", help="names, or long, short")
    parser.add_argument("--save", type=Path)
    parser.add_argument("--against", type=Path)
    arguments = parser.parse_args()
    found: digests.Digests = {}
    failed = 0
    for run in known((*LONG, *SHORT)):
        if {run.name, "long" if run in LONG else "short"} & set(arguments.runs):
            try:
                streams = record(run)
            except Exception as error:  # the other runs are still worth knowing
                traceback.print_exc()
                _say(f"{run.name} failed: {error!r}")
                failed += 1
                continue
            found |= {(run.name, topic): digests.digest(rows) for topic, rows in streams.items()}
            _say(f"{run.name} recorded")
            if arguments.save:
                arguments.save.mkdir(parents=True, exist_ok=True)
                np.savez(arguments.save / f"{run.name}.npz", **streams)
            if arguments.against and (difference := _difference(arguments.against / f"{run.name}.npz", streams)):
                _say(f"{run.name} differs: {difference}")
    arguments.output.write_text("".join(f"{line}\n" for line in digests.lines(found)), encoding="utf-8")
    return 1 if failed else 0


def _say(line: str) -> None:
    print(line, flush=True)  # noqa: T201  # what a parent shows


def _difference(path: Path, streams: Streams) -> str:
    with np.load(path) as kept:
        return digests.first_difference(kept, streams)


if __name__ == "__main__":
    sys.exit(main())
