# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Recorded runs on the page: the slider, its marks, steps to impacts, two runs at once; the server that comes back."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from kits.browser import Page, wait_until

from impact_rig.errors import RecordingError
from impact_rig.lab.playback import PlaybackSource
from impact_rig.lab.server import Server


@pytest.fixture
def shown(sample: Path) -> Iterator[Callable[..., Server]]:
    """Serve runs; ended in order."""
    open_ones: list[tuple[Server, PlaybackSource]] = []

    def serve(*paths: Path) -> Server:
        source = PlaybackSource(paths or [sample])
        source.start()
        server = Server(source, port=0)
        server.start()
        open_ones.append((server, source))
        return server

    yield serve
    for server, source in open_ones:
        server.close()
        source.close()


def at(page: Page, seconds: float) -> None:
    page.wait(f"Math.abs(lab.now.playback.now - {seconds}) < 0.01", f"the instant {seconds} s")


def seek(page: Page, seconds: float) -> None:
    page.js(
        f"(() => {{ const p = document.getElementById('position'); p.value = {seconds};"
        " p.dispatchEvent(new Event('input')); p.dispatchEvent(new Event('change')); })()"
    )


def test_play_pause_jump_and_step_to_the_next_impact(
    shown: Callable[..., Server], open_page: Callable[..., Page]
) -> None:
    page = open_page(shown().address)
    page.wait("window.lab && lab.drawn.pictures > 2", "the first traces")
    page.click("#play")
    page.wait("!lab.now.playback.playing", "a pause")
    seek(page, 15.0)
    at(page, 15.0)
    page.wait("Math.abs(lab.scope.trace.now - 15) < 0.02", "traces of that instant")
    page.wait("document.getElementById('dt-number').textContent !== '–'", "the measurement of before")
    page.wait("lab.now.playback.read === 1 && lab.now.impact_marks.some(n => n)", "the marks")
    page.click("#next-impact")
    page.wait("lab.now.playback.now > 15", "the next impact")
    then = page.js("lab.now.playback.now")
    page.key(",")
    page.wait(f"lab.now.playback.now < {then}", "the one before")
    page.choose("#play-speed", "20")
    page.wait("lab.now.playback.speed === 20", "twenty times")
    page.click("#play")
    page.wait("lab.now.playback.now === lab.now.playback.end && !lab.now.playback.playing", "the end")


def test_knobs_are_those_of_the_recording_and_cannot_be_turned(
    shown: Callable[..., Server], open_page: Callable[..., Page]
) -> None:
    page = open_page(shown().address)
    page.wait("window.lab && lab.now.applied", "the state")
    seek(page, 0.5)
    page.wait("document.getElementById('knob-current').value === '0'", "no current before the command")
    seek(page, 10.0)
    page.wait("document.getElementById('knob-current').value === '0.52'", "the current of then")
    controls = "#knob-frequency, #knob-law, #run, #stop, #record, [data-mark]"
    assert page.js(f"[...document.querySelectorAll('{controls}')].every(e => e.disabled)")
    assert page.js("lab.link.ask('stop').answer.then(a => a.ok)") is False


def test_two_runs_side_by_side(
    shown: Callable[..., Server], open_page: Callable[..., Page], sample: Path, tmp_path: Path
) -> None:
    other = shutil.copytree(sample, tmp_path / "other")
    page = open_page(shown(sample, other).address, 1920, 1080, prefers_color_scheme="dark")
    seek(page, 12.0)
    page.wait("lab.scope.other && lab.drawn.pictures > 2", "traces of both")
    page.wait("lab.now.dt_b?.length > 0 && lab.now.dt.length === lab.now.dt_b.length", "measurements of both")
    assert "sample and other" in page.js("lab.now.rig.text")


def test_a_run_that_was_cut_short(
    shown: Callable[..., Server], open_page: Callable[..., Page], sample: Path, tmp_path: Path
) -> None:
    broken = tmp_path / "broken"
    broken.mkdir()
    (whole,) = sample.glob("*.mcap")
    (broken / "run.mcap").write_bytes(whole.read_bytes()[: whole.stat().st_size * 2 // 3])
    page = open_page(shown(broken).address)
    page.wait("window.lab && lab.now.rig?.text.includes('cut short')", "the words about it")
    page.wait("lab.drawn.pictures > 2", "what is whole")
    assert 5.0 < page.js("lab.now.playback.end") < 20.0


def test_what_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError):
        PlaybackSource([tmp_path / "nothing"])


def test_the_page_comes_back_after_the_server_and_keeps_what_it_had(
    shown: Callable[..., Server], open_page: Callable[..., Page], sample: Path
) -> None:
    server = shown()
    page = open_page(server.address)
    seek(page, 19.0)
    page.wait("window.lab && lab.now.dt?.length > 0", "a measurement")
    count = page.js("lab.now.dt.length")
    server.close()
    page.wait("document.getElementById('word').textContent === 'offline'", "the connection to be missed")
    assert page.js("document.body.classList.contains('stale') && lab.now.dt.length") == count
    source = PlaybackSource([sample])
    with Server(source, port=server.port, token=server.token), source:
        pictures = page.js("lab.drawn.pictures")
        page.wait(f"lab.link.connected && lab.drawn.pictures > {pictures}", "traces after the restart")
        wait_until(lambda: page.text("#word") == "playback", "the word")
        page.errors[:] = [error for error in page.errors if "ERR_CONNECTION_REFUSED" not in error]
