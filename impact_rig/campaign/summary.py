# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`summary.json` of a run or campaign directory: the figures that programs read."""

from __future__ import annotations

import json
import math
from pathlib import Path

import attrs

import impact_rig
from impact_rig.campaign.paper import REDUCTION_PERCENT, Reductions
from impact_rig.system import files

FILE_NAME = "summary.json"


@attrs.frozen
class Statement:
    """One claim, judged on the data."""

    passed: bool
    value: float
    limit: float


def write_summary(
    directory: Path,
    reductions: Reductions,
    statements: dict[str, Statement],
    *,
    lost_blocks: int,
    wall_s: float,
    simulated_s: float,
    seed: int,
    more: dict[str, object] | None = None,
) -> Path:
    """Write `summary.json` and return its path; numbers that do not exist are null."""
    content = {
        "version": impact_rig.__version__,
        "seed": seed,
        "dt_no_sphere": reductions.dt_no_sphere,
        "dt": _by_millimetre(reductions.dt),
        "reductions_percent": _by_millimetre(reductions.percent()),
        "reductions_uncertainty_points": _by_millimetre(reductions.percent_uncertainty),
        "paper_reductions_percent": _by_millimetre(REDUCTION_PERCENT),
        "max_abs_error_points": reductions.max_abs_error(),
        "rms_error_points": reductions.rms_error(),
        "statements": {
            name: {"pass": statement.passed, "value": statement.value, "limit": statement.limit}
            for name, statement in statements.items()
        },
        "lost_blocks": lost_blocks,
        "wall_s": wall_s,
        "simulated_s": simulated_s,
        **(more or {}),
    }
    path = directory / FILE_NAME
    files.write_text(path, json.dumps(_finite(content), indent=2) + "\n")
    return path


def _by_millimetre(values: object) -> dict[str, float]:
    return {f"{gap * 1e3:g}": value for gap, value in dict(values).items()}  # type: ignore[call-overload]  # any mapping


def _finite(value: object) -> object:
    """JSON has no NaN."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value
