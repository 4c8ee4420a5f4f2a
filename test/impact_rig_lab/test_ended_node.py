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
"""Nodes that die or cannot measure: shown in grey, restarted from the page; a command ends with its rig."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.browser import Page

from impact_rig.client import Processes, isolated_domain
from impact_rig_lab.gateway import OwnedProcesses
from impact_rig_lab.live import LiveSource
from impact_rig_lab.server import Server

pytestmark = [pytest.mark.ros, pytest.mark.pipeline]


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[tuple[Processes, str]]:
    parameters = {
        "rig": {"time.start_wait_s": 0.0, "time.factor": 2.0, "daq.rate_hz": 4000},  # half of the load of 10 kHz
        "analysis": {"gap_m": 0.006},
        "recorder": {"record": False, "directory": str(tmp_path)},
    }
    with isolated_domain() as domain_id, Processes(domain_id, tmp_path / "logs", "/rig") as processes:
        source = LiveSource(domain_id, "/rig", OwnedProcesses(processes, parameters))
        with Server(source, port=0) as server, source:
            yield processes, server.address


def wait_for_state(page: Page, expected: str) -> None:
    page.wait(f"document.getElementById('word').textContent === '{expected}'", f"the word {expected}")


def test_a_node_that_ends_is_greyed_out_until_it_returns(
    graph: tuple[Processes, str], open_page: Callable[..., Page]
) -> None:
    processes, address = graph
    page = open_page(address)
    page.wait("window.lab && lab.now.rig?.word === 'at rest' && lab.drawn.pictures > 2", "a rig at rest")
    page.wait("['analysis', 'recorder'].every(name => lab.now.sources[name].lives)", "the other nodes")
    page.key("r")
    wait_for_state(page, "measured")
    assert not page.js("document.getElementById('dt-value').classList.contains('old')")

    processes.running["analysis"].signal(9)
    wait_for_state(page, "driving")
    page.wait("document.getElementById('dt-value').classList.contains('old')", "the value to be grey")
    assert "does not apply now" in page.text("#dt-why")
    assert "the analysis is gone" in page.text("#notice-text")
    page.wait("document.querySelector('#notice-buttons button').textContent === 'Start again'", "the offer")
    page.click("#notice-buttons button")
    wait_for_state(page, "measured")

    page.click("#record")
    page.wait("document.getElementById('recording').textContent.includes('run_')", "a recording")
    processes.running["recorder"].signal(9)
    page.wait("document.getElementById('recording').textContent === 'no recorder'", "its end")
    assert page.js("document.getElementById('record').disabled")
    assert page.js("lab.link.ask('note', {value: 'lost'}).answer.then(a => a.text)").startswith(
        "no recorder is running"
    )
    assert not page.js("lab.now.journal.some(line => line[1] === 'note')")

    for _ in range(10):  # on a busy machine, the analysis may be silent for a moment, and the answer then says so
        page.wait("lab.now.sources.analysis.lives", "the analysis")
        if (answer := page.js("lab.link.ask('gap', {value: 0}).answer.then(a => a.text)")) == "no sphere":
            break
    assert answer == "no sphere"
    page.wait("lab.now.journal.some(line => line.slice(1).join(' ') === 'parameter sphere.present 0')", "the change")
    page.key("0")
    page.wait("lab.now.applied.current === 0", "rest")
    page.write("#knob-current", "1.2")
    page.wait("lab.now.sources.analysis.state === 'unable'", "an over range")
    page.wait("document.getElementById('sentence').title.includes('cannot be measured now: over range')", "why not")
    page.wait("document.getElementById('dt-why').textContent === 'not measured: over range'", "why not")
    assert page.js("document.getElementById('settling').hidden")

    page.js("document.activeElement.blur()")
    processes.running["rig"].signal(signal.SIGSTOP)
    wait_for_state(page, "dead")
    page.key("0")
    page.wait("document.querySelector('.knob.refused .words')?.textContent.includes('no report from')", "a refusal")
    assert page.js("document.querySelectorAll('.pending').length") == 0
    stood = page.js("lab.now.rig.time")
    processes.running["rig"].signal(signal.SIGCONT)
    page.wait(f"lab.now.rig.word === 'driving' && lab.now.rig.time > {stood}", "the rig to go on")
    assert page.js("lab.now.applied.current") == 1.2, "nothing of what was asked of the silent rig"

    processes.running["rig"].signal(9)
    wait_for_state(page, "dead")
    assert page.js("document.body.classList.contains('stale')")
    assert "code -9" in page.text("#notice-text")
    page.key("r")
    page.wait("document.querySelector('.knob.refused .words')?.textContent.includes('rig is gone')", "a refusal")
    assert page.js("document.querySelectorAll('.pending').length") == 0
    pictures = page.js("lab.drawn.pictures")
    page.click("#notice-buttons button")
    page.wait("lab.now.rig.word === 'at rest'", "the rig to be started again")
    page.wait(f"lab.drawn.pictures > {pictures} && lab.now.rig.time > 4", "traces of the new rig, for a while")
    assert not page.js("document.body.classList.contains('stale')")
    assert page.js("lab.now.rig.word") == "at rest", "nothing of what was asked of the dead rig"
    assert not page.js("lab.now.applied?.current")
    assert page.js("document.querySelectorAll('.knob.refused').length") == 0
    old = "lab.link.rig = 'f00'; lab.link.ask('current', {value: 0.2}).answer.then(a => a.text)"
    assert "another rig has started" in page.js(old), "a command for the rig that the page showed before"
