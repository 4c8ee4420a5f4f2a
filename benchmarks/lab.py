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
"""Cost of the live page: 50 kS/s in real time with one Chromium and two socket clients, one of them stalled.

The load of the rig is measured alternately with and without pages, and compared by the median of pairs. `SECONDS` is
the length of a turn, `PAIRS` the number of pairs, and `MEMORY_S` how long the memory of the lab process is observed.
Every wait has a limit, and each step is printed. The benchmark takes six minutes by default, and names a step that
hangs.
"""

from __future__ import annotations

import asyncio
import json
import os
import statistics
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import aiohttp

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "test"))

from kits.browser import Browser  # noqa: E402

from benchmarks.cpu import cpu_share, resident_mb  # noqa: E402
from benchmarks.live import FREE_RUNNING_WINDOW, graph  # noqa: E402
from impact_rig.client import Client, Processes  # noqa: E402
from impact_rig.errors import ImpactRigError  # noqa: E402

RATE_HZ = 50_000
NODES = ("rig", "analysis", "recorder")
DRIVE = {"drive.amplitude": 0.52, "barriers.gap_m": 0.006}
TRACE = 3
LONGEST_S = 3600.0
"""Longest life of a socket client, whatever happens."""
PATIENCE_S = 60.0
"""Time limit of a step that is not measured, such as opening a page or ending a process."""


def tell(text: str) -> None:
    """Print the present step."""
    print(f"lab: {text}", flush=True)  # a command line tool talks


def run() -> dict[str, float]:
    """Measure everything."""
    seconds, pairs = float(os.environ.get("SECONDS", "10")), int(os.environ.get("PAIRS", "5"))
    return {**_live(seconds, pairs), **_free_running(seconds, pairs)}


def _live(seconds: float, pairs: int) -> dict[str, float]:
    parameters = {"daq.rate_hz": RATE_HZ, "daq.block_scans": RATE_HZ // 100, **DRIVE}
    with graph(parameters) as (client, processes, directory), _lab(processes, directory) as (address, lab):
        browser = Browser()
        try:
            extra, drawn, script, shares = [], [], [], []
            for turn in range(pairs):
                tell(f"50 kS/s, pair {turn + 1} of {pairs}: without a page")
                without = _share(processes.running["rig"].pid, client, seconds)
                with _pages(browser, address) as page:
                    client.spin_for(2.0)
                    tell("the same with a page and two sockets")
                    page.js("window.costs = []; window.lab.onDrawn = ms => window.costs.push(ms);")
                    before, lab_share, began = page.js("lab.drawn.pictures"), cpu_share(lab.pid), time.monotonic()
                    extra.append(_share(processes.running["rig"].pid, client, seconds) - without)
                    wall = time.monotonic() - began
                    drawn.append((page.js("lab.drawn.pictures") - before) / wall)
                    shares.append(lab_share())
                    tell(f"{drawn[-1]:.1f} pictures/s, lab {shares[-1]:.1f} %, rig {extra[-1]:+.2f} points")
                    script.append(page.js("costs.sort((a, b) => a - b)[Math.floor(costs.length * 0.5)]"))
            tell("memory of the lab's process")
            grown = _memory(browser, address, lab, client)
            lost = float(client.figures("analysis").get("lost_scans", "nan")) / (RATE_HZ // 100)
            recorded = client.figures("recorder")
            lost += sum(float(value) for name, value in recorded.items() if name.startswith("lost."))
            return {
                "lab_fps": statistics.median(drawn),
                "lab_script_ms_per_frame": statistics.median(script),
                "lab_process_cpu_percent": statistics.median(shares),
                "lab_rig_cpu_extra_percent": statistics.median(extra),
                "lab_lost_blocks": lost,
                "lab_memory_growth_mb": grown,
            }
        finally:
            browser.close()


def _free_running(seconds: float, pairs: int) -> dict[str, float]:
    """Return the speed at which analysis and recorder follow, alternately with and without a page."""
    parameters = {
        "time.mode": "free_running", "time.peers": ("analysis", "recorder"),
        "time.ack_window": FREE_RUNNING_WINDOW, **DRIVE,
    }  # fmt: skip
    with graph(parameters) as (client, processes, directory), _lab(processes, directory) as (address, _):
        browser = Browser()
        try:
            without, speeds = [_speed(client, seconds)], []
            for turn in range(pairs):
                tell(f"free_running, pair {turn + 1} of {pairs}: with a page, then without one")
                with _pages(browser, address, sockets=0):
                    client.spin_for(2.0)
                    speeds.append(_speed(client, seconds))
                client.spin_for(2.0)
                without.append(_speed(client, seconds))
            ratios = [  # relative to the mean of before and after: a drift of the machine's speed cancels
                speed / (0.5 * (before + after))
                for speed, before, after in zip(speeds, without, without[1:], strict=False)
            ]
            return {
                "lab_freewheel_x_realtime": statistics.median(speeds),
                "lab_freewheel_slower_percent": 100.0 * (1.0 - statistics.median(ratios)),
            }
        finally:
            browser.close()


@contextmanager
def _lab(processes: Processes, directory: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Run the lab as a separate process, as a user does, attached to the graph."""
    log = directory / "lab.log"
    environment = {**os.environ, "ROS_DOMAIN_ID": str(processes.domain_id), "XDG_STATE_HOME": str(directory)}
    command = [sys.executable, "-c", "from impact_rig.cli import main; raise SystemExit(main())", "lab"]
    with log.open("wb") as output:
        lab = subprocess.Popen(
            [*command, "--attach", "/", "--no-browser", "--port", "0"], stdout=output, stderr=output, env=environment
        )
    try:
        deadline = time.monotonic() + PATIENCE_S
        while not (found := [line for line in log.read_text().splitlines() if line.startswith("http")]):
            if lab.poll() is not None or time.monotonic() > deadline:
                raise ImpactRigError(f"the lab has not started (exit code {lab.poll()}): {log.read_text()[-2000:]}")
            time.sleep(0.05)
        yield found[0], lab
    finally:
        lab.terminate()
        try:
            lab.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            tell("the lab did not end after the signal: killed")
            lab.kill()
            lab.wait()


@contextmanager
def _pages(browser: Browser, address: str, sockets: int = 2) -> Iterator[object]:
    """Open a page in Chromium, and socket clients, the first of which never draws."""
    page = browser.page(1280, 800)
    page.goto(address)
    page.wait("window.lab && lab.drawn.pictures > 5", "traces")
    end, troubles = threading.Event(), list[str]()
    threads = [
        threading.Thread(target=_client, args=(address, number > 0, end, troubles), daemon=True)
        for number in range(sockets)
    ]
    for thread in threads:
        thread.start()
    try:
        yield page
    finally:
        end.set()
        for thread in threads:
            thread.join(PATIENCE_S)
        page.close()
    if troubles or any(thread.is_alive() for thread in threads):
        raise ImpactRigError(f"a socket client failed, or did not end: {'; '.join(troubles) or 'still talking'}")


def _client(address: str, draws: bool, end: threading.Event, troubles: list[str]) -> None:
    base, _, token = address.partition("/?token=")

    async def talk() -> None:
        async with aiohttp.ClientSession() as session:
            socket = await session.ws_connect(f"{base}/socket?token={token}", headers={"Origin": base}, max_msg_size=0)
            while not end.is_set():
                if not draws:
                    await asyncio.sleep(0.1)  # never reads
                    continue
                message = await asyncio.wait_for(socket.receive(), PATIENCE_S)
                if message.type is not aiohttp.WSMsgType.BINARY:
                    raise ImpactRigError(f"the lab has closed a socket that draws: {message}")
                if message.data[0] == TRACE:
                    frame = struct.unpack_from("<I", message.data, 4)[0]
                    await socket.send_str(json.dumps({"do": "ack", "frame": frame}))
            await socket.close()

    try:
        asyncio.run(asyncio.wait_for(talk(), LONGEST_S))
    except Exception as error:  # reported to the thread that waits for this one
        troubles.append(f"{'drawing' if draws else 'stalled'}: {type(error).__name__} {error}")


def _share(pid: int, client: Client, seconds: float) -> float:
    share = cpu_share(pid)
    client.spin_for(seconds)
    return share()


def _speed(client: Client, seconds: float) -> float:
    marks = []
    for duration in (0.0, seconds):
        client.spin_for(duration)
        status = client.status("rig")
        client.wait_until(lambda status=status: client.status("rig") is not status, "diagnostics")  # type: ignore[misc]
        marks.append((time.monotonic(), float(client.figures("rig")["rig_time_s"])))
    (began, first), (ended, last) = marks
    return (last - first) / (ended - began)


def _memory(browser: Browser, address: str, lab: subprocess.Popen[bytes], client: Client) -> float:
    """Return the growth of the lab process [MB] while a page is open."""
    with _pages(browser, address):
        client.spin_for(15.0)
        before = _usual_mb(lab.pid, client)
        client.spin_for(float(os.environ.get("MEMORY_S", "60")))
        return _usual_mb(lab.pid, client) - before


def _usual_mb(pid: int, client: Client) -> float:
    """Return the median of some readings, because a spectrum or a long trace takes megabytes for a moment."""
    readings = []
    for _ in range(20):
        client.spin_for(0.25)
        readings.append(resident_mb(pid))
    return statistics.median(readings)
