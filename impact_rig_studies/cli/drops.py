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
"""Command `impact-rig analyze --drop`: the coefficient of restitution from the drop tests noted in a run."""

from __future__ import annotations

import argparse
import math

import numpy as np

from impact_rig.analysis.uncertainty_budget import plus_minus
from impact_rig.cli.analyze import draw_figure, prepare_figure
from impact_rig.cli.terminal import Console, TextTable, tell_json
from impact_rig.recording import Run


def run_drop(console: Console, run: Run, arguments: argparse.Namespace) -> int:
    """Print the drops noted in an open run and the coefficient of restitution from them; return the exit code.

    The code is 1 if the uncertainty of the coefficient is not finite; else 0.
    """
    from impact_rig.analysis.drawings import restitution_by_drop  # noqa: PLC0415  # heavy: after the run is open
    from impact_rig_studies.drops import drops_of  # noqa: PLC0415  # as above

    prepare_figure(arguments, "drop")
    drops, found = drops_of(run, arguments.drop)
    each = np.array([math.sqrt(one.h1_m / one.h0_m) for one in drops])
    if arguments.json:
        tell_json(
            {
                "run": str(run.path),
                "restitution": found.restitution,
                "u_restitution": found.u_restitution,
                "drops": [{"h0_m": one.h0_m, "h1_m": one.h1_m, "e": e} for one, e in zip(drops, each, strict=True)],
            }
        )
    table = TextTable("Drop test", right=("drop", "from [m]", "back to [m]", "e"))
    for number, (one, e) in enumerate(zip(drops, each, strict=True), 1):
        table.add_row(str(number), f"{one.h0_m:g}", f"{one.h1_m:g}", f"{e:.4f}")
    console.print(table)
    draw_figure(
        console, run, arguments, "drop", lambda: restitution_by_drop(each, found.restitution, found.u_restitution)
    )
    if not math.isfinite(found.u_restitution):
        console.print(
            f"{found.drops} drops give no uncertainty of the coefficient of restitution e: state that of the heights "
            "with --drop, or note more drops",
            style="red",
        )
        return 1
    console.print(
        f"coefficient of restitution e = {plus_minus(found.restitution, found.u_restitution)} (2u) from "
        f"{found.drops} drops"
    )
    return 0
