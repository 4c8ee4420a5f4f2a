# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A rig that dies: grey, last seen, and started again from the page."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.browser import Page

from impact_rig.client import Processes, isolated_domain
from impact_rig.lab.gateway import Own
from impact_rig.lab.live import LiveSource
from impact_rig.lab.server import Server

pytestmark = [pytest.mark.ros, pytest.mark.pipeline]


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[tuple[Processes, str]]:
    with isolated_domain() as domain_id, Processes(domain_id, tmp_path / "logs", "/rig") as processes:
        source = LiveSource(domain_id, "/rig", Own(processes, {"rig": {"time.start_wait_s": 0.0}}))
        with Server(source, port=0) as server, source:
            yield processes, server.address


def test_it_is_grey_says_when_it_was_seen_and_comes_back(
    graph: tuple[Processes, str], open_page: Callable[..., Page]
) -> None:
    processes, address = graph
    page = open_page(address)
    assert page.js("performance.getEntriesByType('paint').length === 0 || performance.now() < 30000")
    page.wait("window.lab && lab.now.rig?.word === 'at rest' && lab.drawn.pictures > 2", "a rig at rest")
    processes.running["rig"].signal(9)
    page.wait("document.getElementById('word').textContent === 'dead'", "the end to be seen")
    assert page.js("document.body.classList.contains('stale')")
    assert "code -9" in page.text("#notice-text")
    pictures = page.js("lab.drawn.pictures")
    page.click("#notice-buttons button")
    page.wait("document.getElementById('word').textContent === 'at rest'", "the rig to be started again")
    page.wait(f"lab.drawn.pictures > {pictures}", "traces of the new rig")
    assert not page.js("document.body.classList.contains('stale')")
