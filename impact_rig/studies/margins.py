# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What the paper's statements owe to the choice of constants: each judged anew on rigs of which one constant differs.

The points come from a campaign that varies constants one at a time (`config/campaigns/margins.yaml`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import attrs

from impact_rig.campaign.plan import RESET
from impact_rig.campaign.results import Curves, Point
from impact_rig.campaign.statements import Verdict, judge
from impact_rig.config.tree import Value


@attrs.frozen(eq=False)
class Variation:
    """One rig and what becomes of the statements on it.

    Attributes:
        changed: the constants that differ from the campaign's reference rig, by dotted name; none: that rig itself.
        verdicts: on each statement.
    """

    changed: Mapping[str, Value]
    verdicts: list[Verdict]


def variations(points: Sequence[Point]) -> list[Variation]:
    """Return the verdicts on every rig on which one can be made, the reference rig first.

    Empty if that is the only one. Points at another current than the reference rig's tell nothing and are left out.
    """
    currents = {point.current_a for point in points if point.reference}
    rigs: dict[tuple[tuple[str, Value], ...], list[Point]] = {}
    for point in points:
        if point.direction == RESET and point.current_a in currents:
            changed = () if point.reference else tuple(sorted(point.axes.items()))
            rigs.setdefault(changed, []).append(attrs.evolve(point, reference=True))
    found = [Variation(dict(rig), judge(Curves.of(rigs[rig]))) for rig in sorted(rigs, key=len)]
    judged = [one for one in found if any(verdict.result for verdict in one.verdicts)]
    return judged if len(judged) > 1 else []
