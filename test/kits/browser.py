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
"""A real Chromium without a window, driven by its own protocol in a separate thread; every call waits until it is done.

`IMPACT_RIG_REQUIRE_BROWSER=1` makes a missing browser an error instead of a reason to skip.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import importlib.util
import itertools
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from impact_rig.client.client import WaitTimeoutError

PATIENCE_S = float(os.environ.get("IMPACT_RIG_PATIENCE", "60"))
NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
SERIOUS = ("serious", "critical")
REQUIRED = os.environ.get("IMPACT_RIG_REQUIRE_BROWSER") == "1"
KEYS = {
    "Escape": 27, "Enter": 13, "Tab": 9, " ": 32, "ArrowUp": 38, "ArrowDown": 40, "ArrowLeft": 37, "ArrowRight": 39,
}  # fmt: skip


SAYS = """JSON.stringify({
  visible: document.visibilityState, word: document.getElementById("word")?.textContent,
  said: ["sentence", "notice-text", "answer", "recording"].map((name) => document.getElementById(name)?.textContent),
  knobs: [...document.querySelectorAll(".knob input, .knob select")].map((one) => [one.value, {...one.dataset}]),
  refused: [...document.querySelectorAll(".knob .words")].map((one) => one.textContent).join(""),
  active: document.activeElement?.id, drawn: {...window.lab?.drawn, trace: undefined},
  rig: window.lab?.now?.rig, recorder: window.lab?.now?.recorder,
})"""
"""JavaScript whose value explains why a wait timed out."""
PORT = re.compile(r"//127\.0\.0\.1:(\d+)/")


def _answers(port: str) -> bool:
    try:
        socket.create_connection(("127.0.0.1", int(port)), PATIENCE_S).close()
    except ConnectionError:
        return False
    return True


def chromium() -> str:
    """Return the path of a Chromium; without one, skip the test, or fail if a browser is required."""
    found = next((path for name in NAMES if (path := shutil.which(name))), None)
    if found is None and REQUIRED:
        pytest.fail("IMPACT_RIG_REQUIRE_BROWSER=1, but there is no chromium")
    if found is None:
        pytest.skip("no Chromium here: apt install chromium")
    return found


class Browser:
    """Chromium process; `page` opens a page in its own profile."""

    def __init__(self) -> None:
        self._directory = tempfile.mkdtemp(prefix="impact_rig_browser_")
        self._log = Path(self._directory, "log").open("wb")  # noqa: SIM115  # for as long as the process runs
        self._process = subprocess.Popen(
            [
                chromium(), "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
                "--no-first-run",
                "--disable-extensions", "--disable-background-networking", "--disable-component-update",
                "--disable-background-timer-throttling", "--disable-renderer-backgrounding",
                "--disable-backgrounding-occluded-windows", "--remote-debugging-port=0",
                f"--user-data-dir={self._directory}", "about:blank",
            ],
            stdin=subprocess.DEVNULL, stdout=self._log, stderr=self._log, start_new_session=True,
        )  # fmt: skip
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="browser", daemon=True)
        self._thread.start()
        self._answers: dict[int, asyncio.Future[Any]] = {}
        self._numbers = itertools.count(1)
        self._pages: dict[str, Page] = {}
        self.run(self._connect())

    def run(self, work: Coroutine[Any, Any, Any]) -> Any:
        """Return the result of a coroutine in the browser's loop."""
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(PATIENCE_S)

    async def _connect(self) -> None:
        port = Path(self._directory, "DevToolsActivePort")
        deadline = time.monotonic() + PATIENCE_S
        while not (port.exists() and len(port.read_text().splitlines()) == 2):
            assert self._process.poll() is None, Path(self._log.name).read_text(errors="replace")[-2000:]
            assert time.monotonic() < deadline, "Chromium does not listen"
            await asyncio.sleep(0.05)
        number, path = port.read_text().splitlines()
        self._session = aiohttp.ClientSession()
        self._socket = await self._session.ws_connect(f"ws://127.0.0.1:{number}{path}", max_msg_size=0)
        self._reader = asyncio.create_task(self._read())

    async def _read(self) -> None:
        async for message in self._socket:
            found = message.json()
            if "id" in found:
                future = self._answers.pop(found["id"], None)
                if future is not None and not future.done():
                    future.set_result(found)
            elif (page := self._pages.get(found.get("sessionId", ""))) is not None:
                page.on_event(found["method"], found["params"])

    def call(self, method: str, session: str | None = None, **params: Any) -> Any:
        """Return the result of a method of the protocol."""

        async def ask() -> Any:
            number = next(self._numbers)
            self._answers[number] = self._loop.create_future()
            message = {"id": number, "method": method, "params": params}
            await self._socket.send_json(message | ({"sessionId": session} if session else {}))
            return await self._answers[number]

        answer = self.run(ask())
        assert "error" not in answer, f"{method}: {answer['error']}"
        return answer["result"]

    def page(self, width: int = 1280, height: int = 800, **features: str) -> Page:
        """Open a page; `features` are media features, with `_` for the hyphen."""
        context = self.call("Target.createBrowserContext")["browserContextId"]
        target = self.call("Target.createTarget", url="about:blank", browserContextId=context)["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        page = self._pages[session] = Page(self, session, context)
        page.open(width, height, features)
        return page

    def close_pages(self) -> None:
        """Close the pages that are still open, because a page that a failed test has left continues to draw."""
        for page in list(self._pages.values()):
            page.close()

    def forget(self, session: str) -> bool:
        """Ignore further events of a page; return whether it was known."""
        return self._pages.pop(session, None) is not None

    def close(self) -> None:
        """End the browser."""

        async def end() -> None:
            self._reader.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._reader
            await self._socket.close()
            await self._session.close()

        self.run(end())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._log.close()
        shutil.rmtree(self._directory, ignore_errors=True)


class Page:
    """Page; `errors` are the complaints of its console, `fetched` the addresses that it requested.

    A complaint that contains `expected` does not count: a test that stops the server expects some, which arrive late.
    """

    def __init__(self, browser: Browser, session: str, context: str) -> None:
        self.errors: list[str] = []
        self.expected: str | None = None
        self.fetched: list[str] = []
        self._browser, self._session, self._context = browser, session, context

    def faults(self) -> list[str]:
        """Complaints of the page, without those about a server that has ended: Chromium may request icons then."""
        return [error for error in self.errors if "net::ERR_" not in error or any(map(_answers, PORT.findall(error)))]

    def on_event(self, method: str, params: dict[str, Any]) -> None:
        """Record an event of the page."""
        if method == "Runtime.exceptionThrown":
            self.errors.append(str(params["exceptionDetails"].get("exception", params)))
        elif method == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning", "assert"):
            self.errors.append(str(params["args"]))
        elif method == "Log.entryAdded" and params["entry"]["level"] in ("error", "warning"):
            error = f"{params['entry']['text']} {params['entry'].get('url', '')}"
            if self.expected is None or self.expected not in error:
                self.errors.append(error)
        elif method == "Network.requestWillBeSent":
            self.fetched.append(params["request"]["url"])

    def call(self, method: str, **params: Any) -> Any:
        return self._browser.call(method, self._session, **params)

    def open(self, width: int, height: int, features: dict[str, str]) -> None:
        for domain in ("Runtime", "Log", "Page", "Network"):
            self.call(f"{domain}.enable")
        self.size(width, height)
        media = [{"name": name.replace("_", "-"), "value": value} for name, value in features.items()]
        self.call("Emulation.setEmulatedMedia", features=media)

    def size(self, width: int, height: int) -> None:
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def goto(self, address: str) -> None:
        """Load a page and wait until its modules have run."""
        self.call("Page.navigate", url=address)
        self.wait("document.readyState === 'complete'", f"{address} to load")

    def js(self, expression: str) -> Any:
        """Return the value of an expression; a promise is awaited."""
        found = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in found, f"{expression}: {found['exceptionDetails']}"
        return found["result"].get("value")

    def wait(self, expression: str, what: str, timeout_s: float = PATIENCE_S) -> Any:
        """Wait until an expression is true and return its value; it is evaluated after every picture of the page."""
        try:
            return wait_until(lambda: self.js(expression), what, timeout_s)
        except WaitTimeoutError as error:
            raise WaitTimeoutError(f"{error}; errors {self.errors}; the page: {self.js(SAYS)}") from None

    def text(self, selector: str) -> str:
        return str(self.js(f"document.querySelector({selector!r}).textContent"))

    def click(self, selector: str) -> None:
        """Click with the mouse in the middle of the selected element, when it does not move and nothing covers it."""
        x, y = self.wait(
            f"(async () => {{ const e = document.querySelector({selector!r}); if (!e) return;"
            " e.scrollIntoView({block: 'nearest'}); const frame = () => new Promise(requestAnimationFrame);"
            " const at = () => { const b = e.getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2] };"
            " const before = at(); await frame(); await frame(); const still = `${at()}` === `${before}`;"
            " return still && e.contains(document.elementFromPoint(...before)) && before; })()",
            f"{selector} to stand still in sight",
        )
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def key(self, key: str, shift: bool = False) -> None:
        """Press a key."""
        text = {"text": "\r"} if key == "Enter" else {"text": key} if len(key) == 1 else {}
        common = {
            "key": key,
            "windowsVirtualKeyCode": KEYS.get(key, ord(key.upper()[0])),
            "modifiers": 8 if shift else 0,
        }
        self.call("Input.dispatchKeyEvent", type="keyDown", **common, **text)
        self.call("Input.dispatchKeyEvent", type="keyUp", **common)

    def write(self, selector: str, text: str) -> None:
        """Replace the content of a field by the keyboard, and press Enter."""
        self.js(f"(() => {{ const e = document.querySelector({selector!r}); e.focus(); e.select(); }})()")
        self.call("Input.insertText", text=text)
        self.key("Enter")

    def choose(self, selector: str, value: str) -> None:
        """Choose an entry of a select element."""
        self.js(
            f"(() => {{ const e = document.querySelector({selector!r}); e.value = {value!r};"
            " e.dispatchEvent(new Event('change', {bubbles: true})); })()"
        )

    def picture(self, path: Path) -> None:
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def close(self) -> None:
        """Close the page and its profile, if it is open."""
        if self._browser.forget(self._session):
            self._browser.call("Target.disposeBrowserContext", browserContextId=self._context)


def serious_faults(page: Page) -> list[str]:
    """Return rule, element and description of each fault that axe calls serious or critical; skip the test without axe.

    For people who cannot see it, a drawing is one image, so its thousands of parts are left out.
    """
    axe = importlib.util.find_spec("axe_core_python")
    if axe is None:
        pytest.skip("axe is only on PyPI")
    page.call("Runtime.evaluate", expression=Path(axe.origin).with_name("axe.min.js").read_text(encoding="utf-8"))
    found = page.js(
        "axe.run({exclude: [['svg > *']]}, {resultTypes: ['violations']}).then(r => JSON.stringify(r.violations))"
    )
    return [
        f"{rule['id']}: {node['html'][:120]}: {node['failureSummary']}"
        for rule in json.loads(found)
        if rule["impact"] in SERIOUS
        for node in rule["nodes"]
    ]


def wait_until(condition: Callable[[], Any], what: str, timeout_s: float = PATIENCE_S) -> Any:
    """Return the result of `condition` as soon as it is true; the function is called repeatedly."""
    deadline = time.monotonic() + timeout_s
    while not (found := condition()):
        if time.monotonic() > deadline:
            raise WaitTimeoutError(f"waited {timeout_s:g} s in vain for {what}")
        time.sleep(0.02)
    return found
