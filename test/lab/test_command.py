# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`impact-rig lab` as a program: its first words and pages, attaching to rigs, and what it refuses."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from kits.browser import PATIENCE_S, Page, wait_until

from impact_rig import topics
from impact_rig.cli import main
from impact_rig.lab.sample import make
from impact_rig.recording import open_run

PROGRAM = [sys.executable, "-c", "from impact_rig.cli import main; raise SystemExit(main())"]


@contextmanager
def lab(directory: Path, *arguments: str, **environment: str) -> Iterator[str]:
    """Run the program, and give the address it prints; it ends like any other when it is told to."""
    log = directory / "lab.log"
    with log.open("wb") as output:
        process = subprocess.Popen(
            [*PROGRAM, "lab", "--no-browser", "--port", "0", *arguments],
            stdout=output, stderr=output, cwd=directory,
            env={**os.environ, "XDG_STATE_HOME": str(directory), **environment},
        )  # fmt: skip
    try:

        def address() -> str:
            assert process.poll() is None, log.read_text()
            return next((line for line in log.read_text().splitlines() if line.startswith("http")), "")

        yield wait_until(address, "the address")
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 128 + signal.SIGINT, log.read_text()


def test_a_run_is_there_at_once(sample: Path, open_page: Callable[..., Page], tmp_path: Path) -> None:
    began = time.monotonic()
    with lab(tmp_path, str(sample)) as address:
        page = open_page(address)
        page.wait("window.lab && lab.drawn.pictures > 0", "the first traces")
        assert time.monotonic() - began < 30.0
        page.js("lab.link.socket.onclose = null")


def test_the_sample_says_what_the_analysis_was_set_to(sample: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written = {path.name: path.stat().st_mtime_ns for path in sample.iterdir()}
    assert make(sample) == sample
    assert {path.name: path.stat().st_mtime_ns for path in sample.iterdir()} == written
    assert main(["analyze", str(sample)]) == 0
    words = capsys.readouterr().out
    assert "identical to the live results: 3 rows, bit for bit" in words
    assert " 6 " in next(line for line in words.splitlines() if "periodic" in line), "the gap is known"


def test_a_sample_of_an_earlier_version_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as before:
        before.setattr("impact_rig.lab.sample.SECONDS", 0)
        before.setattr("impact_rig.lab.sample.TOPICS", (topics.INFO.name, topics.ANALYSIS_SETTINGS.name))
        make(tmp_path / "sample")
    monkeypatch.setattr("impact_rig.lab.sample.SECONDS", 1)
    with open_run(make(tmp_path / "sample")) as run:
        assert f"/rig/{topics.SCAN.name}" in run.topics


@pytest.mark.ros
@pytest.mark.pipeline
def test_of_two_rigs_one_is_chosen(open_page: Callable[..., Page], tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.client import Processes, isolated_domain

    with isolated_domain() as domain_id:
        first, second = (Processes(domain_id, tmp_path / name, f"/{name}") for name in ("one", "two"))
        with first, second:
            for processes in (first, second):
                processes.start("rig")
            with lab(tmp_path, "--attach", ROS_DOMAIN_ID=str(domain_id)) as address:
                page = open_page(address)
                page.wait("window.lab && lab.now.rig?.word", "the state")
                page.wait(
                    "document.querySelectorAll('#notice-buttons button').length === 2 || lab.now.rig.name", "a choice"
                )
                if page.js("lab.now.rig.word") == "choose":
                    page.click("#notice-buttons button:nth-child(2)")
                page.wait("['/one', '/two'].includes(lab.now.rig.name) && lab.drawn.pictures > 2", "the rig")
                page.js("lab.link.socket.onclose = null")


def test_what_makes_no_sense_is_refused(sample: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["lab", str(tmp_path / "nothing"), "--no-browser"]) == 1
    assert "neither a run directory nor an MCAP file" in capsys.readouterr().err
    assert main(["lab", "a", "b", "c"]) == 1
    assert "at most two" in capsys.readouterr().err
    assert main(["lab", str(sample), "--attach", "/rig"]) == 1
    assert "not both" in capsys.readouterr().err
