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
"""Every control of the page, used in a real Chromium; the effect is checked on the ROS side."""

from __future__ import annotations

import contextlib
import json
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from kits.browser import PATIENCE_S, SAYS, Page, wait_until

from impact_rig import codec
from impact_rig.blocks import Table
from impact_rig.client import Client, Collector, Processes, WaitTimeoutError, isolated_domain
from impact_rig.nodes import messages
from impact_rig.nodes.messages import by_name
from impact_rig.rig.config import load_config
from impact_rig_lab.gateway import OwnedProcesses
from impact_rig_lab.live import LiveSource
from impact_rig_lab.server import MOST_UNDRAWN, Server
from impact_rig_lab.server import PATIENCE_S as AWAY_S
from impact_rig_lab.state import DEAD_S

pytestmark = [pytest.mark.ros, pytest.mark.pipeline]

PARAMETERS = {
    "rig": {
        "time.mode": "realtime", "time.factor": 2.0, "time.peers": ["analysis", "recorder"], "daq.rate_hz": 4000,
    },
    "analysis": {"gap_m": 0.006},
    "recorder": {"record": False},
}  # fmt: skip
"""Twice real time: what settles in ten seconds is there in five, and two cores carry it and a browser. The page draws
envelopes, so it does the same at 4 kHz as at 10 kHz, and the nodes need less than half of the time."""


USUAL = {
    "time.factor": 2.0,
    "sphere.present": True,
    "barriers.gap_m": 0.006,
    "sphere.start": "left",
    "contact.law": "flores",
    "contact.restitution": 0.35,
    "instruments.faults.planned": [""],
}


@attrs.define
class Lab:
    """Fixtures of a test: the page's address, and a second view of the graph."""

    server: Server
    source: LiveSource
    client: Client
    processes: Processes
    directory: Path
    topics: dict[str, Collector]
    page: Page | None = None  # the newest

    def journal(self) -> list[tuple[str, str, float]]:
        """Return kinds, keys and values of the journal so far."""
        self.client.spin_for(0.0)
        entries = self.topics["rig/journal"].entries()
        return [(entry.kind.value, entry.name, entry.value or 0.0) for entry in entries]

    def until(self, condition: Callable[[], Any], what: str) -> Any:
        """Wait for a condition on the ROS side; if it times out, report what the page shows."""
        try:
            return self.client.wait_until(condition, what, PATIENCE_S)
        except WaitTimeoutError as error:
            raise WaitTimeoutError(f"{error}; the page: {self.page.js(SAYS) if self.page else None}") from None

    def parameter(self, node: str, name: str, value: object) -> None:
        """Wait until a parameter has a value."""
        self.until(lambda: self.client.get_parameters(node, [name])[name] == value, f"{name} = {value}")

    def applied(self, column: str, value: float) -> None:
        """Wait until the shaker applies the command."""
        rows = self.topics["shaker/applied"]
        self.until(lambda: np.any(np.isclose(rows.rows()[column][-1:], value)), f"{column} {value}")


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    directory = tmp_path_factory.mktemp("lab_runs")
    parameters = {**PARAMETERS, "recorder": {"record": False, "directory": str(directory)}}
    with isolated_domain() as domain_id, Processes(domain_id, directory / "logs", "/rig") as processes:
        source = LiveSource(domain_id, "/rig", OwnedProcesses(processes, parameters))
        with Server(source, port=0) as server, source, Client(domain_id, "rig", name="observer") as client:
            client.wait_active("rig", "analysis", "recorder")
            client.wait_until(lambda: "blocks" in client.figures("rig"), "scan 0", PATIENCE_S)
            names = ("rig/journal", "shaker/applied", "transmissibility/table", "truth/faults")
            topics = {name: client.collect(name, timeout_s=60.0) for name in names}
            yield Lab(server, source, client, processes, directory, topics)


@pytest.fixture
def page(lab: Lab, open_page: Callable[..., Page]) -> Page:
    """Page on which traces are drawn, of a rig at rest with the default settings, without faults of an earlier test."""
    lab.client.trigger("rig/clear_trip")
    lab.client.trigger("rig/reset")
    lab.client.set_parameters("rig", USUAL)
    lab.client.set_parameters("analysis", PARAMETERS["analysis"])
    found = lab.page = open_page(lab.server.address)
    found.wait("window.lab && lab.drawn.pictures > 2", "the first traces")
    return found


def wait_for_state(page: Page, *expected: str) -> None:
    page.wait(f"{list(expected)!r}.includes(document.getElementById('word').textContent)", f"the word {expected}")


def answered(page: Page, words: str) -> None:
    page.wait(f"document.getElementById('answer').textContent.includes({words!r})", f"the answer {words!r}")


@contextlib.contextmanager
def ending(lab: Lab, node: str) -> Iterator[None]:
    """End a process that the page has started; after a failure the page must forget it, as the test may be repeated."""
    with contextlib.ExitStack() as at_the_end:
        at_the_end.callback(time.sleep, DEAD_S)
        at_the_end.callback(lambda: node in lab.processes.running and lab.processes.stop(node))
        yield
        at_the_end.pop_all()
        lab.processes.stop(node)


def test_the_key_r_leads_to_a_settled_transmissibility(lab: Lab, page: Page) -> None:
    """Nothing else is changed, and progress is shown until ± 2u appears."""
    wait_for_state(page, "at rest")
    page.key("r")
    lab.applied("frequency", 9.1)
    lab.applied("current", 0.52)
    page.wait("!document.getElementById('settling').hidden", "progress of settling")
    wait_for_state(page, "measured")
    page.wait("/^\\d+\\.\\d+$/.test(document.getElementById('dt-number').textContent)", "a number")
    assert page.text("#dt-u").startswith("± ")
    rows = lab.topics["transmissibility/table"].rows

    def is_a_settled_row() -> bool:  # the page may be a row ahead of us
        shown = float(page.text("#dt-number"))
        return any(r["settled"] == 1 and abs(shown - float(r["transmissibility"])) < 0.5 for r in rows())

    lab.until(is_a_settled_row, "the settled row that the page shows")
    page.wait("lab.now.prediction?.words.startsWith('Predicted for 6 mm, 0.52 A')", "what theory says")
    ipc = page.js("lab.now.dt.at(-1).ipc")
    if abs(ipc - 2.0) > 0.05:
        page.wait(f"lab.now.other_motion.startsWith('Measured: {ipc:.2f} impacts')", "that theory means another motion")
    untold = "[...document.querySelectorAll('#bar dt, #word, #dt-more dt, .knob label')].filter(e => !e.title)"
    assert page.js(f"{untold}.map(e => e.textContent)") == []
    curve(page, lab.directory)
    page.click("[data-mark='gap-4']")
    page.wait("lab.now.prediction.words.startsWith('Predicted for 4 mm')", "the prediction to follow the gap")
    wait_for_state(page, "settling", "driving")
    assert page.js("lab.now.dt_now.holds") is False, "that value was of another gap"
    page.wait("lab.motion.impacts.length > 0", "impacts in the new gap")
    assert page.js("lab.drawn.epoch") == lab.source.record.epoch


def curve(page: Page, directory: Path) -> None:
    """A point can be removed and restored; the browser saves curve and scope."""
    page.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(directory))
    for button, name in (
        ("curve-csv", "transmissibility.csv"),
        ("curve-picture", "transmissibility.png"),
        ("scope-picture", "scope.png"),
    ):
        page.js(f"document.getElementById('{button}').click()")
        wait_until(lambda path=directory / name: path.exists() and path.stat().st_size, name)
    lines = (directory / "transmissibility.csv").read_text().splitlines()
    assert lines[0].startswith("time_s,frequency_hz,transmissibility,standard_uncertainty")
    assert {line.count(",") for line in lines} == {12}
    assert float(lines[-1].split(",")[1]) == 9.1
    assert (directory / "scope.png").read_bytes()[:4] == b"\x89PNG"
    count = page.js("lab.curve.rows.length")
    time_s = page.js("lab.curve.rows.at(-1).t")
    page.js("document.activeElement.blur()")
    page.key("Delete")
    page.wait(f"lab.now.dt.at(-1).t > {time_s}", "another row, with which the whole table comes again")
    assert page.js(f"lab.now.dt.some(row => row.t === {time_s}) && !lab.curve.rows.some(row => row.t === {time_s})")
    assert page.js(f"lab.curve.csv().includes('\\n{time_s},')") is False
    page.js("document.getElementById('curve-back').click()")
    assert page.js(f"lab.curve.csv().includes('\\n{time_s},')")
    page.wait(f"lab.curve.rows.length >= {count}", "it to come back")


def test_fields_sliders_keys_and_the_button_of_the_paper_set_values(lab: Lab, page: Page) -> None:
    page.write("#knob-frequency", "9.4")
    lab.applied("frequency", 9.4)
    page.wait("document.querySelectorAll('.pending').length === 0", "the echo")
    page.click("[data-mark='frequency-9.1']")
    lab.applied("frequency", 9.1)
    page.wait("document.querySelectorAll('.pending').length === 0", "the echo")
    page.wait("document.getElementById('knob-frequency').value === '9.1'", "the field to follow")
    page.js("document.activeElement.blur()")
    page.key("]")
    lab.applied("frequency", 9.11)
    page.wait("document.getElementById('knob-frequency').value === '9.11'", "the field to follow")
    page.js(
        "(() => { const s = document.querySelector('[aria-label=\"Current slider\"]'); s.value = 0.3;"
        " s.dispatchEvent(new Event('change')); })()"
    )
    lab.applied("current", 0.3)
    page.wait("document.getElementById('knob-current').value === '0.3'", "the field to follow")


def test_the_error_of_the_rig_is_shown_next_to_the_rejected_control(lab: Lab, page: Page) -> None:
    before = page.js("lab.now.applied.frequency")
    page.write("#knob-frequency", "900")
    page.wait("document.querySelector('.knob.refused .words')?.textContent.includes('got 900')", "the refusal")
    assert page.js("lab.now.applied.frequency") == before
    page.write("#knob-restitution", "7")
    page.wait(
        "[...document.querySelectorAll('.words')].some(e => e.textContent.includes('contact.restitution'))", "why"
    )
    lab.parameter("rig", "contact.restitution", 0.35)


def test_gap_sphere_law_and_restitution_can_be_set(lab: Lab, page: Page) -> None:
    page.click("[data-mark='gap-4']")
    lab.parameter("rig", "barriers.gap_m", 0.004)
    lab.parameter("analysis", "gap_m", 0.004)
    page.click("[data-mark='gap-0']")
    lab.parameter("rig", "sphere.present", False)
    lab.parameter("analysis", "gap_m", 0.0)
    page.write("#knob-gap", "6")
    lab.parameter("rig", "barriers.gap_m", 0.006)
    lab.parameter("rig", "sphere.present", True)
    page.choose("#knob-start", "right")
    lab.parameter("rig", "sphere.start", "right")
    page.choose("#knob-law", "hu_guo")
    lab.parameter("rig", "contact.law", "hu_guo")
    page.write("#knob-restitution", "0.4")
    lab.parameter("rig", "contact.restitution", 0.4)
    page.wait("document.querySelectorAll('.pending, .refused').length === 0", "every echo")


def test_typed_text_replaces_a_value_received_meanwhile(lab: Lab, page: Page) -> None:
    """If 4 mm arrives while the field has the focus, and 6 is typed, the gap must become 6 mm, not 46 mm."""
    page.js("(() => { const e = document.getElementById('knob-gap'); e.focus(); e.select(); })()")
    lab.client.set_parameters("rig", {"barriers.gap_m": 0.004})
    page.wait("document.getElementById('knob-gap').value === '4'", "what came")
    page.call("Input.insertText", text="8")
    page.key("Enter")
    lab.parameter("rig", "barriers.gap_m", 0.008)
    lab.parameter("analysis", "gap_m", 0.008)  # set last: what the lab does must be over before the next test


def test_a_stop_latches_until_it_is_cleared(lab: Lab, page: Page) -> None:
    page.click("#stop")
    wait_for_state(page, "tripped")
    lab.until(lambda: any(kind == "stop" for kind, _, _ in lab.journal()), "the stop in the journal")
    page.write("#knob-current", "0.1")
    page.wait("document.querySelectorAll('.knob.refused').length > 0", "a command refused while latched")
    page.click("#notice-buttons button")
    lab.until(lambda: any(kind == "clear_trip" for kind, _, _ in lab.journal()), "the cleared latch")
    wait_for_state(page, "at rest")
    page.wait("document.querySelectorAll('.knob.refused').length === 0", "the refusal to go with its cause")


def test_the_stop_button_stays_above_the_help_sheet(lab: Lab, page: Page) -> None:
    for stop in (lambda: page.click("#stop"), lambda: page.key("Escape")):
        page.js("document.activeElement.blur()")
        page.key("?")
        page.wait("document.getElementById('sheet').open", "the sheet")
        stop()
        wait_for_state(page, "tripped")
        page.js("document.getElementById('sheet').close()")
        page.key("c")
        wait_for_state(page, "at rest")


def test_all_of_the_result_can_be_reached_in_a_low_window(page: Page) -> None:
    page.size(1366, 500)
    page.wait("dt.scrollHeight > dt.clientHeight + 20", "a result higher than its place")
    x, y = page.js("(({x, y, width, height}) => [x + width / 2, y + height / 8])(dt.getBoundingClientRect())")
    page.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=2000)
    page.wait("dt.scrollTop + dt.clientHeight > dt.scrollHeight - 2", "its end")


def no_accelerometer() -> tuple[str, Any]:
    rows = np.zeros(3, [("time", "f8"), ("laser", "S32"), ("status", "u1")])
    return "daq/scan", Table(10**9, rows)


def no_wall() -> tuple[str, Any]:
    return "truth/impacts", Table(10**9, np.zeros(1, [("time", "f8"), ("approach_speed", "f8")]))


def no_number() -> tuple[str, Any]:
    return "/diagnostics", {"current_a": "none", "rig_time_s": "soon", "lost_blocks": "nan"}


@pytest.mark.parametrize("hostile", [no_accelerometer, no_wall, no_number])
def test_a_stop_works_despite_invalid_messages_of_others(
    lab: Lab, page: Page, hostile: Callable[[], tuple[str, Any]]
) -> None:
    """A bad message costs only that message: it is counted and shown, and a current of zero still takes effect."""
    page.write("#knob-current", "0.2")
    lab.applied("current", 0.2)
    name, content = hostile()
    client = lab.client
    if name == "/diagnostics":
        own = client.status("rig")
        values = [KeyValue(key=one.key, value=content.get(one.key, one.value)) for one in own.values]
        message = DiagnosticArray(status=[DiagnosticStatus(name=own.name, level=b"\0", values=values)])
        publisher = client.publisher(by_name(name))
        for _ in range(3):
            publisher.publish(message)
            client.spin_for(0.1)
    else:
        publisher = client.publisher(by_name(name))
        counted = f"lab.now.refused['{name}']?.[0] > 0 && !document.getElementById('refused-box').hidden"

        def published_and_counted() -> bool:  # data drawn only while the page can follow it must not be received
            publisher.publish(codec.encode(content))
            return bool(page.js(counted))

        lab.until(published_and_counted, "the count")
    client.node.destroy_publisher(client._publishers.pop(name))
    page.key("Escape")  # from within a field, too
    lab.applied("current", 0.0)
    wait_for_state(page, "tripped")
    page.js("document.activeElement.blur()")
    pictures = page.js("lab.drawn.pictures")
    page.wait(f"lab.drawn.pictures > {pictures}", "the pictures to go on")
    page.key("c")
    wait_for_state(page, "at rest")


def test_a_rival_publisher_is_named_while_it_exists(lab: Lab, page: Page) -> None:
    """A rig with a second publisher of its topics must not be shown as "at rest"."""
    wait_for_state(page, "at rest")
    topic = by_name("truth/impacts")
    rival = lab.client.node.create_publisher(messages.class_of(topic), topic.name, messages.profile(topic.qos))
    wait_for_state(page, "rival")
    page.wait(
        "document.getElementById('sentence').title.includes('/rig/observer publishes truth/impacts as well')",
        "its name",
    )
    lab.client.node.destroy_publisher(rival)
    wait_for_state(page, "at rest")


def test_settings_can_be_saved_and_applied_again(lab: Lab, page: Page, tmp_path: Path) -> None:
    page.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    page.click("[data-mark='gap-8']")
    lab.parameter("rig", "barriers.gap_m", 0.008)
    page.wait("lab.now.knobs['barriers.gap_m'] === 0.008 && lab.now.configuration.includes('gap_m: 0.008')", "the echo")
    page.js("document.getElementById('settings-save').click()")
    saved = tmp_path / "rig.yaml"
    wait_until(lambda: saved.exists() and saved.stat().st_size, "the file")
    assert load_config(saved).barriers.gap_m == 0.008
    lab.client.set_parameters("rig", USUAL)
    page.wait("lab.now.knobs['barriers.gap_m'] === 0.006", "another gap")
    asked = "lab.link.ask('load', {{value: {}}}).answer"
    answer = page.js(asked.format(json.dumps(saved.read_text())))
    assert answer == {"id": answer["id"], "ok": True, "text": "1 settings changed"}
    lab.parameter("rig", "barriers.gap_m", 0.008)
    lab.parameter("analysis", "gap_m", 0.008)
    for text, words in (("a: [", "cannot be read as plain YAML"), ("barriers: {gap_mm: 6}", "did you mean")):
        answer = page.js(asked.format(json.dumps(text)))
        assert not answer["ok"]
        assert words in answer["text"]


def test_an_error_states_the_value_in_the_displayed_unit(page: Page) -> None:
    page.write("#knob-gap", "-1")
    page.wait("document.querySelector('.knob.refused .words')?.textContent.includes('got -1 mm')", "the refusal")


def test_a_clicked_button_is_not_pressed_again_by_space(lab: Lab, page: Page) -> None:
    page.click("#reset")
    page.wait("document.getElementById('answer').textContent !== ''", "the answer")
    page.key(" ")
    wait_for_state(page, "paused")
    page.key(" ")
    wait_for_state(page, "at rest")


def test_pluck_pause_and_reset_reach_the_rig(lab: Lab, page: Page) -> None:
    judged = lab.source.record.curve.judged
    before = [*judged]
    page.click("#pluck")
    wait_for_state(page, "plucked")
    # the jump, where it falls into a window that is measured, or a base that stands still
    unsound = lambda: [row for row in [*judged] if row not in before and row.status in ("spikes", "no_signal")]  # noqa: E731
    wait_until(unsound, "what the analysis makes of it")
    shown = page.js("lab.now.rig.time")
    page.wait(f"lab.now.rig.time > {shown} + 1", "the page to know of it")
    assert page.text("#health") == "–", "no channel is at fault"
    page.click("#pause")
    wait_for_state(page, "paused")
    lab.until(lambda: "paused" in lab.client.status("rig").message, "the rig to be paused")
    page.click("#pause")
    wait_for_state(page, "plucked")
    epoch = page.js("lab.drawn.epoch")
    page.click("#reset")
    wait_for_state(page, "at rest")
    lab.until(lambda: any(kind == "reset" for kind, _, _ in lab.journal()), "the reset in the journal")
    page.wait(f"lab.drawn.epoch > {epoch}", "a new record to be drawn")


def test_faults_and_remarks_reach_the_rig(lab: Lab, page: Page) -> None:
    """The laser's error is below its calibration uncertainty: only the truth can show it."""
    page.js("document.getElementById('faulting').open = true")
    page.choose("#fault-kind", "gain_error")
    for field, value in (("fault-value", 0.003), ("fault-duration", 1000)):
        page.js(f"document.getElementById('{field}').value = {value}")
    page.click("#fault-start")
    lab.until(lambda: len(lab.topics["truth/faults"].rows()) > 0, "the fault in truth/faults")
    page.wait("document.getElementById('faults').textContent === 'gain error laser (0.003)'", "that it is active")
    assert page.js("document.querySelector('#bar dt:has(+ #faults) .badge').textContent") == "truth"
    page.js("document.activeElement.blur()")
    page.key("r")
    page.wait("lab.now.sources?.analysis.state === 'measuring'", "the analysis, which cannot see it")
    wait_for_state(page, "driving")
    said = "document.getElementById('sentence').textContent.includes('gain error laser (0.003) is active (truth)')"
    page.wait(said, "the reason")
    page.click("#fault-clear")
    answered(page, "cleared")
    page.wait("document.getElementById('faults').textContent === 'none'", "its end")
    page.key("0")
    hostile = "<img src=x onerror=alert(1)><b>bold"
    notes = lab.client.collect("notes")
    page.write("#note", hostile)
    lab.until(lambda: any(message.data == hostile for message in notes.messages), "the remark")
    page.wait("document.getElementById('journal-list').textContent.includes('<b>bold')", "the remark as it is")
    assert page.js("document.querySelectorAll('#journal-list b, #journal-list img').length") == 0


def test_a_recording_can_be_started_and_ended(lab: Lab, page: Page) -> None:
    page.click("#record")
    page.wait("document.getElementById('recording').textContent.includes('run_')", "the name of the run")
    page.click("#record")
    page.wait("document.getElementById('recording').textContent === 'off'", "the end")
    runs = list(lab.directory.glob("run_*/metadata.yaml"))
    assert len(runs) == 1

    (lab.directory / "taken").touch()
    lab.client.set_parameters("recorder", {"directory": str(lab.directory / "taken")})
    page.click("#record")
    page.wait("document.getElementById('recording').textContent === 'failed'", "the failure")
    page.wait("/Nothing is recorded: .*taken/.test(document.getElementById('notice-text').textContent)", "the reason")
    lab.client.set_parameters("recorder", {"directory": str(lab.directory)})
    page.click("#record")  # while nothing is recorded, this warning covers that of the rig
    page.wait("document.getElementById('recording').textContent.includes('run_')", "the name of the next run")
    page.wait("document.getElementById('notice').hidden", "the end of the warning")
    page.click("#record")
    page.wait("document.getElementById('recording').textContent === 'off'", "its end")


def test_scope_spectrum_slow_motion_and_themes_work(page: Page) -> None:
    for span in ("0.05", "10"):
        page.choose("#span", span)
        page.wait(f"Math.abs(lab.scope.span() - {span}) < 0.05 * {span}", f"a window of {span} s")
    page.click("#trigger")
    page.wait("lab.scope.trace && isNaN(lab.scope.trace.trigger)", "no trigger")
    page.click("#hold")
    move = "lab.scope.plots[0].setCursor({left: lab.scope.plots[0].over.clientWidth * %s, top: 20})"
    page.js(move % 0.25)
    page.js("lab.scope.plots[0].over.click()")
    page.js(move % 0.5)
    time_s, frequency_hz = page.js(
        "/^Δ (\\S+) s \\((\\S+) (?:m?)Hz\\): acc.* current/.exec(lab.scope.readout.textContent).slice(1)"
    )
    assert float(time_s) == pytest.approx(2.5, rel=0.02), "a quarter of the window of ten seconds"
    assert float(frequency_hz) == pytest.approx(400.0, rel=0.02)
    page.js("lab.scope.plots[0].over.dispatchEvent(new MouseEvent('dblclick'))")
    page.js(move % 0.4)
    assert not page.text("#cursor").startswith("Δ")
    page.click("#hold")
    page.choose("#spectrum-channel", "current")
    page.wait("lab.spectrum.channel === 3", "the spectrum of the current")
    page.click("[data-slow='0.1']")
    page.wait("document.getElementById('rig-note').textContent.includes('slow motion')", "slow motion")
    before = page.js("document.documentElement.dataset.theme")
    page.js("document.activeElement.blur()")
    page.key("t")
    assert page.js("document.documentElement.dataset.theme") != before
    page.key("?")
    page.wait("document.getElementById('sheet').open", "the sheet of keys and words")
    assert page.js("document.querySelectorAll('#sheet-words dt').length") > 70
    page.key("?")
    page.wait("!document.getElementById('sheet').open", "the sheet to close")


def test_a_sweep_extends_the_curve_and_a_point_can_be_revisited(lab: Lab, page: Page) -> None:
    with ending(lab, "stepped_sine"):
        sweep(lab, page)


def sweep(lab: Lab, page: Page) -> None:
    page.js("document.getElementById('sweeping').open = true")
    page.js("document.getElementById('sweep-from').value = 8; document.getElementById('sweep-to').value = 8.5;")
    page.js("document.getElementById('sweep-points').value = 2")
    page.click("#sweep-start")
    lab.applied("frequency", 8.0)
    lab.applied("frequency", 8.5)
    page.wait("lab.now.sweep.text.startsWith('finished')", "the sweep to finish")
    page.wait("lab.now.dt.some(r => r.f === 8) && lab.now.dt.some(r => r.f === 8.5)", "both points")
    x, y = page.js(
        "(() => { const p = lab.curve.plot, b = p.over.getBoundingClientRect(), r = lab.now.dt.find(r => r.f === 8);"
        " return [b.left + p.valToPos(r.f, 'x'), b.top + p.valToPos(r.dt, 'y')]; })()"
    )
    for kind in ("mousePressed", "mouseReleased"):
        page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    lab.applied("frequency", 8.0)
    for kind in ("mousePressed", "mouseReleased"):
        page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1, modifiers=8)
    page.wait("lab.curve.removed.size === 1 && lab.now.dt.length > lab.curve.rows.length", "a point to go, with Shift")
    page.choose("#sweep-hold", "base")
    assert page.text("#sweep-unit") == "mm"
    page.write("#sweep-target", "0.05")
    lab.parameter("stepped_sine", "hold", "base")
    lab.parameter("stepped_sine", "target", 5e-5)
    page.wait("lab.now.sweep.text.startsWith('point')", "an amplitude to be held")
    page.click("#sweep-stop")
    page.wait("lab.now.sweep.text.startsWith('aborted')", "the end of it")
    page.choose("#sweep-hold", "phase")
    samples = lab.client.collect("sweep/table")
    page.click("#sweep-start")
    lab.until(lambda: len(samples.rows()), "a sample of the lock")
    assert samples.rows()["frequency"][0] == 8.0
    page.wait("/^(seeking|tracking|locked) at/.test(lab.now.sweep.text)", "the search for the resonance")
    page.click("#sweep-stop")
    page.wait("lab.now.sweep.text === 'aborted: stopped by the operator'", "the end of the lock")


def test_two_browsers_show_the_same_rig(lab: Lab, page: Page, open_page: Callable[..., Page]) -> None:
    other = open_page(lab.server.address, 400, 800, prefers_color_scheme="dark")
    other.wait("window.lab && lab.drawn.pictures > 2", "traces on the second page")
    assert other.js("document.documentElement.dataset.theme") == "dark"
    assert other.js("document.documentElement.scrollWidth") <= 400
    page.write("#knob-frequency", "8.7")
    other.wait("document.getElementById('knob-frequency').value === '8.7'", "the other page to follow")
    assert {address.split("/")[2] for address in page.fetched + other.fetched} == {f"127.0.0.1:{lab.server.port}"}


def test_the_page_can_be_used_by_keyboard_alone(lab: Lab, page: Page) -> None:
    """Tab reaches every control that can be used, in the order of the page; keys do everything else."""
    page.key("f")
    assert page.js("document.activeElement.id") == "knob-frequency"
    page.key("ArrowUp")
    page.wait("document.querySelectorAll('.pending').length === 0 && lab.now.applied.frequency > 0", "the echo")
    reached = set()
    for _ in range(60):
        page.key("Tab")
        reached.add(page.js("document.activeElement.id"))
    assert {"stop", "run", "pause", "reset", "pluck", "record", "span", "spectrum-db"} <= reached
    page.js("document.activeElement.blur()")
    page.key("0")
    lab.applied("current", 0.0)
    page.key("Escape")
    wait_for_state(page, "tripped")
    page.key("c")
    wait_for_state(page, "at rest")


def test_a_page_that_does_not_draw_receives_no_pictures(lab: Lab, page: Page) -> None:
    """Pictures are dropped rather than queued: none is sent before the last one was drawn."""
    lab.client.set_parameters("rig", {"time.factor": 1.0})  # a faster rig sends few pictures anyway
    page.wait("lab.now.rig.speed < 1.3", "real time")
    page.js("lab.link.acknowledge = () => undefined")
    page.js("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    count = page.js("lab.drawn.pictures")
    begin, since = lab.source.now_s, time.monotonic()
    wait_until(lambda: lab.source.now_s > begin + 2.0, "two seconds of the rig")
    now_and_then = math.ceil((time.monotonic() - since) / AWAY_S)  # whether the page has come back
    assert page.js("lab.drawn.pictures") <= count + MOST_UNDRAWN + now_and_then


def test_motion_too_fast_to_follow_is_not_drawn(lab: Lab, page: Page) -> None:
    """It is not received either: at many times real time, this would slow the rig. The scope is drawn now and then."""
    page.wait("lab.motion.states.length > 10", "the motion")
    listeners = lab.client.node.count_subscribers("daq/scan")
    lab.client.set_parameters("rig", {"time.factor": 6.0})
    page.wait("document.getElementById('rig-note').textContent.includes('not drawn')", "the page to say so", 60)
    page.wait("lab.motion.states.length === 0", "the end of what was sent before")
    lab.until(lambda: lab.client.node.count_subscribers("truth/joint_states") == 0, "the end of the last subscription")
    begin = lab.source.now_s
    for here in (0, -1, 0):
        lab.until(lambda here=here: lab.client.node.count_subscribers("daq/scan") == listeners + here, "another peek")
    wait_until(lambda: lab.source.now_s > begin + 1.0, "the scope to go on")
    lab.client.set_parameters("rig", {"time.factor": 1.0})
    page.wait("lab.motion.states.length > 10", "the motion again", 60)
