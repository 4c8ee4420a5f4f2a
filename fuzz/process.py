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
"""One target in a process of its own, so that its memory does not include the libraries of other targets."""

from __future__ import annotations

import warnings

from coverage import Coverage

from fuzz.target import Tally, Target, run

PACKAGES = ["impact_rig", "impact_rig_studies", "impact_rig_lab"]


def targets() -> dict[str, Target]:
    """Return all targets by name."""
    from fuzz import calls, decoders, importers, sockets, validators  # noqa: PLC0415  # measured, too

    all_of_them = (
        *decoders.TARGETS, *validators.TARGETS, *importers.TARGETS, *sockets.TARGETS, *calls.TARGETS,
    )  # fmt: skip
    return {one.name: one for one in all_of_them}


def run_one(name: str, inputs: int, number: int) -> tuple[Tally, bytes]:
    """Run a target in this process; return its tally and its branch coverage."""
    warnings.simplefilter("ignore")  # numpy warns about the values that it is asked to compare
    measured = branch_coverage()
    measured.start()
    tally = run(targets()[name], inputs, number)
    measured.stop()
    return tally, measured.get_data().dumps()


def branch_coverage() -> Coverage:
    """Return a new measurement of branch coverage."""
    return Coverage(branch=True, data_file=None, source=PACKAGES, config_file=False)
