"""Fixtures of the recording's tests: a clock that is told the time, and a recording to fill."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from recording_samples import CONFIG, PROVENANCE, HandClock

from impact_rig.recording import Attachment, RunWriter


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def record(tmp_path: Path, clock: HandClock) -> Callable[..., RunWriter]:
    """Start a recording in a directory below `tmp_path`."""

    def start(name: str = "run", **options: object) -> RunWriter:
        defaults: dict[str, object] = {
            "provenance": PROVENANCE,
            "clock": clock,
            "attachments": (Attachment("config.yaml", CONFIG, "application/yaml"),),
        }
        return RunWriter(tmp_path / name, **(defaults | options))  # type: ignore[arg-type]  # options of any test

    return start
