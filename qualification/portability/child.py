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
"""Recording of runs in this process, and their digests: one process, one mask.

    python -m qualification.portability.child OUTPUT RUN... [--save DIRECTORY | --against DIRECTORY]

OUTPUT gets one line per topic. `--save` stores the rows, and `--against` prints where they differ from stored ones.
Without compilation, the tables of outcomes are stored ones, too: they are made of hundreds of contacts, some of which
are a separate run (`short_contacts`). A rig is not tried either before it begins, which would take longer than the run;
the compiled run was tried.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import traceback
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_rig import kernels
from impact_rig.physics import model
from impact_rig.physics.model import build
from impact_rig.rig import core
from qualification.portability import digests
from qualification.portability.runs import LONG, QUICK, SHORT, known

TABLES = "tables.npz"


def main() -> int:
    """Record the runs; return 0 if all could be recorded, whatever their bits."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("output", type=Path, help="file for the digests")
    parser.add_argument("runs", nargs="+", help="names of runs, or long, short, quick")
    parser.add_argument("--save", type=Path, help="folder that stores the rows")
    parser.add_argument("--against", type=Path, help="folder with stored rows to compare with")
    arguments = parser.parse_args()
    tables = Tables(arguments.against if kernels.MODE == "plain" else None)
    if kernels.MODE == "plain":
        core.tried_model = build
    found: digests.Digests = {}
    failed = 0
    for run in known((*LONG, *SHORT, *(run for run in QUICK if run not in SHORT))):
        sets = {word for word, runs in (("long", LONG), ("short", SHORT), ("quick", QUICK)) if run in runs}
        if {run.name, *sets} & set(arguments.runs):
            try:
                streams = run.record(run)
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
            if arguments.against:
                with np.load(arguments.against / f"{run.name}.npz") as kept:
                    if difference := digests.first_difference(kept, streams):
                        _say(f"{run.name} differs: {difference}")
    if arguments.save:
        tables.keep(arguments.save)
    digests.write(found, arguments.output)
    return 1 if failed else 0


class Tables:
    """Tables of outcomes requested by models, by the numbers of their law; from then on models take them from here.

    Args:
        directory: folder with stored tables, if they are not to be computed again.
    """

    def __init__(self, directory: Path | None) -> None:
        self._make = model.tabulate
        self._known: dict[str, NDArray[np.void]] = {}
        if directory:
            with np.load(directory / TABLES) as kept:
                self._known.update(kept)
        model.tabulate = self._of

    def _of(self, p: Any, force: Any) -> Any:
        law = hashlib.sha256(p.tobytes()).hexdigest()
        if law not in self._known:
            self._known[law] = self._make(p, force)
        return self._known[law].view(np.recarray)

    def keep(self, directory: Path) -> None:
        """Store the tables in `directory`."""
        np.savez(directory / TABLES, **self._known)


def _say(line: str) -> None:
    print(line, flush=True)  # noqa: T201  # what a parent shows


if __name__ == "__main__":
    sys.exit(main())
