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
"""`impact-rig lab` as a program: its first output and pages, attaching to rigs, and what it refuses."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import aiohttp
import pytest
from kits import loops
from kits.browser import PATIENCE_S, Page, wait_until
from kits.measured import measured

from impact_rig import topics
from impact_rig.cli import main
from impact_rig.driver.sample_run import make_sample
from impact_rig.recording import open_run
from impact_rig.system import files

PROGRAM = [sys.executable, "-c", "from impact_rig.cli import main; raise SystemExit(main())"]


@contextmanager
def lab(directory: Path, *arguments: str, **environment: str) -> Iterator[str]:
    """Run the program and return the address that it prints; Ctrl-C ends it."""
    log = directory / "lab.log"
    with log.open("wb") as output:
        process = subprocess.Popen(
            [*PROGRAM, "lab", "--no-browser", "--port", "0", *arguments],
            stdout=output, stderr=output, cwd=directory,
            env=measured({**os.environ, "XDG_STATE_HOME": str(directory), **environment}),
        )  # fmt: skip
    try:

        def address() -> str:
            assert process.poll() is None, log.read_text()
            return next((line for line in log.read_text().splitlines() if line.startswith("http")), "")

        yield wait_until(address, "the address")
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0, log.read_text()


def test_the_lab_shows_a_run_at_once(sample: Path, open_page: Callable[..., Page], tmp_path: Path) -> None:
    began = time.monotonic()
    with lab(tmp_path, str(sample)) as address:
        page = open_page(address)
        page.wait("window.lab && lab.drawn.pictures > 0", "the first traces")
        assert time.monotonic() - began < 30.0
        page.js("lab.link.socket.onclose = null")


def test_a_lab_without_a_recorder_names_no_recording_of_another_program(sample: Path, tmp_path: Path) -> None:
    with lab(tmp_path, str(sample)):
        (tmp_path / "runs" / "other").mkdir(parents=True)
        (tmp_path / "runs" / "other" / "other.mcap").touch()
    assert "recorded:" not in (tmp_path / "lab.log").read_text()


@pytest.mark.heavy
def test_the_sample_contains_the_settings_of_the_analysis(sample: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written = {path.name: path.stat().st_mtime_ns for path in sample.iterdir()}
    assert make_sample(sample) == sample
    assert {path.name: path.stat().st_mtime_ns for path in sample.iterdir()} == written
    assert main(["analyze", str(sample)]) == 0
    words = capsys.readouterr().out
    assert "identical to the live results: 3 rows, bit for bit" in words
    assert " 6 " in next(line for line in words.splitlines() if "periodic" in line), "the gap is known"


def test_a_sample_of_an_earlier_version_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as before:
        before.setattr("impact_rig.driver.sample_run.SAMPLE_S", 0)
        before.setattr("impact_rig.driver.sample_run.SAMPLE_TOPICS", (topics.INFO.name, topics.ANALYSIS_SETTINGS.name))
        make_sample(tmp_path / "sample")
    monkeypatch.setattr("impact_rig.driver.sample_run.SAMPLE_S", 1)
    with open_run(make_sample(tmp_path / "sample")) as run:
        assert f"/rig/{topics.SCAN.name}" in run.topics


@pytest.mark.ros
@pytest.mark.pipeline
def test_one_of_two_rigs_is_chosen(open_page: Callable[..., Page], tmp_path: Path) -> None:
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


async def shown(address: str, name: str) -> None:
    """Wait until the page at an address receives a part of the state with this name."""
    at = address.replace("/?", "/socket?")
    async with (
        asyncio.timeout(PATIENCE_S),
        aiohttp.ClientSession() as session,
        session.ws_connect(at, headers={"Origin": address.partition("/?")[0]}, max_msg_size=0) as socket,
    ):
        async for message in socket:
            if name.encode() in message.data:
                return
    raise AssertionError(f"{name} was not sent before the end")


@pytest.mark.ros
@pytest.mark.pipeline
def test_a_second_lab_is_rejected_and_the_end_of_the_pipe_ends_a_lab(tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.client import Client, isolated_domain

    with isolated_domain() as domain_id:
        environment = {**os.environ, "XDG_STATE_HOME": str(tmp_path / "state"), "ROS_DOMAIN_ID": str(domain_id)}
        command = [*PROGRAM, "lab", "--no-browser", "--port", "0", "--namespace", "/bench/two"]
        first = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path, env=environment)
        assert first.stdout is not None
        assert first.stderr is not None
        try:
            address = (
                next(line for line in iter(first.stdout.readline, b"") if line.startswith(b"http")).decode().strip()
            )
            second = subprocess.run(
                command, capture_output=True, cwd=tmp_path, env=environment, timeout=PATIENCE_S, check=False
            )
            assert second.returncode == 1
            words = f"another lab, process {first.pid}, already runs in the namespace /bench/two: stop it, show"
            assert words in second.stderr.decode()
            assert len(second.stderr.splitlines()) == 1
            with Client(domain_id, "bench/two", name="observer") as client:
                client.wait_until(lambda: client.figures("recorder").get("directory"), "a recording", PATIENCE_S)
                directory = client.figures("recorder")["directory"]
            loops.run(shown(address, Path(directory).name))
            first.send_signal(signal.SIGINT)
            words, errors = first.communicate(timeout=PATIENCE_S)
            assert words.decode().splitlines()[-1] == f"recorded: {directory}"
            assert b"Traceback" not in errors
            assert b"interrupted" not in errors, "it was what ends a lab well, and the last line on a terminal"
            assert next(Path(directory).glob("*.mcap")).stat().st_size > 0
            assert {path.name for path in tmp_path.iterdir()} == {"runs", "state"}, "nothing else is left behind"
        finally:
            first.kill()
            first.wait()
        third = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path, env=environment)
        assert third.stdout is not None
        while not third.stdout.readline().startswith(b"http"):
            pass
        third.stdout.close()  # as `| head -2` does
        third.stdout = None
        try:
            assert third.wait(PATIENCE_S) == 128 + signal.SIGPIPE
            assert third.stderr is not None
            assert b"Traceback" not in third.stderr.read()
        finally:
            third.kill()
            third.communicate()


def test_a_lab_whose_process_is_unknown_is_reported_without_a_number(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for name, found in (("hold", None), ("is_held_by_others", False), ("holder", None)):
        monkeypatch.setattr(files, name, lambda *_, found=found: found)
    assert main(["lab", "--output", str(tmp_path), "--no-browser", "--port", "0"]) == 1
    assert "another lab, process unknown, already runs in the namespace /rig" in capsys.readouterr().err


def test_invalid_arguments_are_rejected(sample: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["lab", str(tmp_path / "nothing"), "--no-browser"]) == 1
    assert "nothing does not exist: check the path" in " ".join(capsys.readouterr().err.split())
    assert main(["lab", "a", "b", "c"]) == 1
    assert "at most two" in capsys.readouterr().err
    assert main(["lab", "--scan-rate", "0", "--no-browser", "--port", "0"]) == 1
    assert "daq.rate_hz" in capsys.readouterr().err
    for namespace in ("/a b", "/1", "//"):
        assert main(["lab", "--namespace", namespace, "--no-browser", "--port", "0"]) == 1
        assert "letters, digits" in capsys.readouterr().err
    (tmp_path / "file").touch()
    assert main(["lab", "--output", str(tmp_path / "file" / "runs"), "--no-browser", "--port", "0"]) == 1
    error = capsys.readouterr().err
    assert str(tmp_path / "file" / "runs") in error.replace("\n", "")
    assert "--no-record" in error
    assert main(["lab", str(sample), "--port", "99999", "--no-browser"]) == 1
    assert capsys.readouterr().err.strip().endswith("a port must be 0 (any) to 65535, got 99999")
    assert main(["lab", str(sample), "--attach", "/rig"]) == 1
    assert "choose one" in capsys.readouterr().err


@pytest.mark.ros
def test_a_lab_that_ends_soon_after_its_start_prints_the_path_of_what_it_has_recorded(tmp_path: Path) -> None:
    """The recorder reports its directory once a second; a recording of less than that has a path, too."""
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.client import isolated_domain

    (tmp_path / "runs" / "older").mkdir(parents=True)
    (tmp_path / "runs" / "older" / "older_0.mcap").touch()
    with isolated_domain() as domain_id:
        with lab(tmp_path, ROS_DOMAIN_ID=str(domain_id)):
            wait_until(lambda: [*tmp_path.glob("runs/run_*/*.mcap")], "a recording")
        (directory,) = tmp_path.glob("runs/run_*")
        assert (tmp_path / "lab.log").read_text().splitlines()[-1] == f"recorded: {directory}"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("RUN", "--sample"), "RUN and --sample cannot be combined"),
        (("--sample", "--attach", "/rig"), "--sample and --attach cannot be combined"),
        (("--sample", "--scan-rate", "2000"), "--scan-rate applies only to a rig that this command starts"),
        (("--attach", "/rig", "--namespace", "/two"), "--namespace applies only to a rig"),
        (("--attach", "--no-record"), "--no-record applies only to a rig"),
        (("RUN", "--output", "there"), "--output applies only to a rig"),
        (("RUN", "--mode", "free_running"), "--mode applies only to a rig"),
        (("--rig", "/left"), "--rig applies only to recorded runs"),
    ],
)
def test_an_option_without_effect_is_refused(
    words: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["lab", "--no-browser", *words]) == 1
    assert says in " ".join(capsys.readouterr().err.split())
