"""Look at a report as a browser shows it: no label over another, nothing too small, too wide, fetched or complained of.

    python tools/check_report/check.py runs/campaign_paper/report.html [SCREENSHOTS]

Needs a Chromium (`apt-get install chromium`) and nothing else: it talks to the browser through two pipes (the Chrome
DevTools Protocol). Where axe is installed (`pip install axe-core-python`), it looks for faults of access, too. Takes
screenshots on 1280 and 400 pixels, light and dark, and a PDF of the printed page, writes them to the second argument
(default: beside the report), and exits with 1 if something is wrong.
"""

# ruff: noqa: D102, D103, S603, T201  (a developer's script: it runs the browser and prints)

from __future__ import annotations

import base64
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
from importlib import resources
from pathlib import Path

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
VIEWS = ((1280, "light"), (1280, "dark"), (400, "light"), (400, "dark"))
LEAST_TEXT_PX = 9.0
LONGEST_PX = 16_000  # of a screenshot: longer ones cost gigabytes

TROUBLES = """
(() => {
  const found = [];
  const name = e => (e.textContent || '').trim().slice(0, 40);
  if (document.documentElement.scrollWidth > innerWidth + 1)
    found.push(`the page is ${document.documentElement.scrollWidth} px wide, the window ${innerWidth}`);
  for (const svg of document.querySelectorAll('figure svg')) {
    const label = svg.closest('figure').getAttribute('aria-label').slice(0, 40);
    const frame = svg.getBoundingClientRect();
    if (!frame.width) continue;  // a window of another width shows it
    const texts = [...svg.querySelectorAll('text')].filter(t => name(t)).map(t => [t, t.getBoundingClientRect()]);
    if (!texts.length) found.push(`${label}: no text`);
    texts.forEach(([t, a], i) => {
      const size = parseFloat(getComputedStyle(t).fontSize) * frame.width / svg.viewBox.baseVal.width;
      if (size < LEAST) found.push(`${label}: "${name(t)}" is ${size.toFixed(1)} px`);
      if (a.left < frame.left - 1 || a.right > frame.right + 1 || a.top < frame.top - 1 || a.bottom > frame.bottom + 1)
        found.push(`${label}: "${name(t)}" leaves the drawing`);
      for (const [u, b] of texts.slice(i + 1)) {
        const x = Math.min(a.right, b.right) - Math.max(a.left, b.left);
        const y = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
        if (x > 1 && y > 2.5) found.push(`${label}: "${name(t)}" and "${name(u)}" overlap`);
      }
    });
  }
  for (const e of document.querySelectorAll('h1, h2, p, li, .tile, summary, dt, dd, td, tbody th'))
    if (e.getBoundingClientRect().right > innerWidth + 1) found.push(`"${name(e)}" leaves the page`);
  for (const e of document.querySelectorAll('.scroll'))
    if (e.scrollWidth > e.clientWidth + 1) found.push(`a table is cut off: ${name(e)}`);
  return found;
})()
""".replace("LEAST", str(LEAST_TEXT_PX))

AXE = """
axe.run(document, {resultTypes: ['violations']}).then(found => found.violations
  .filter(one => ['serious', 'critical'].includes(one.impact))
  .map(one => `axe: ${one.id}: ${one.help}: ${one.nodes.slice(0, 3).map(n => n.html.slice(0, 120)).join(' | ')}`))
"""


class Browser:
    """A headless browser at the other end of two pipes."""

    def __init__(self, profile: Path) -> None:
        program = next(filter(None, map(shutil.which, BROWSERS)), None)
        if program is None:
            raise SystemExit(f"none of {', '.join(BROWSERS)} is installed")
        to_browser, ours_out = os.pipe()
        ours_in, from_browser = os.pipe()

        def connect() -> None:  # the protocol's fixed numbers
            os.dup2(to_browser, 13), os.dup2(from_browser, 14)
            os.dup2(13, 3), os.dup2(14, 4)

        self._process = subprocess.Popen(
            [program, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--disable-dev-shm-usage",
             "--remote-debugging-pipe", f"--user-data-dir={profile}", "about:blank"],
            preexec_fn=connect,  # noqa: PLW1509  # this process has no threads
            pass_fds=(3, 4), stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(to_browser), os.close(from_browser)
        self._out, self._in = os.fdopen(ours_out, "wb"), os.fdopen(ours_in, "rb")
        self._number, self._rest, self._session = 0, b"", ""
        self.events: list[dict] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Network", "Log", "Runtime"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: object) -> dict:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        self._out.write(json.dumps(message).encode() + b"\0")
        self._out.flush()
        while True:
            answer = self._read()
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]
            self.events.append(answer)

    def wait_for(self, method: str) -> None:
        while not any(event.get("method") == method for event in self.events):
            self.events.append(self._read())

    def close(self) -> None:
        self._session = ""
        self.call("Browser.close")
        self._process.wait(20)

    def _read(self) -> dict:
        while b"\0" not in self._rest:
            part = os.read(self._in.fileno(), 1 << 20)
            if not part:
                raise SystemExit("the browser has ended")
            self._rest += part
        message, _, self._rest = self._rest.partition(b"\0")
        return json.loads(message)


def look(browser: Browser, page: Path, folder: Path) -> list[str]:
    """Show the page in every view and return what is wrong."""
    wrong = []
    for width, scheme in VIEWS:
        browser.events.clear()
        browser.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=width < 600
        )
        browser.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        browser.call("Page.navigate", url=page.as_uri())
        browser.wait_for("Page.loadEventFired")
        found = browser.call("Runtime.evaluate", expression=TROUBLES, returnByValue=True)["result"]["value"]
        wrong += [f"{width} px, {scheme}: {trouble}" for trouble in [*found, *_faults_of_access(browser)]]
        for event in browser.events:
            kind, values = event.get("method"), event.get("params", {})
            if kind == "Network.requestWillBeSent":
                url = values["request"]["url"]
                if url != page.as_uri() and not url.startswith("data:"):
                    wrong.append(f"{width} px: requests {url}")
            elif kind == "Runtime.exceptionThrown" or (
                kind == "Log.entryAdded" and values["entry"]["level"] in ("error", "warning")
            ):
                wrong.append(f"{width} px: console: {json.dumps(values)[:200]}")
        size = browser.call("Page.getLayoutMetrics")["cssContentSize"]
        clip = {"x": 0, "y": 0, "width": width, "height": min(size["height"], LONGEST_PX), "scale": 1}
        picture = browser.call("Page.captureScreenshot", format="png", clip=clip, captureBeyondViewport=True)
        (folder / f"report_{width}_{scheme}.png").write_bytes(base64.b64decode(picture["data"]))
    printed = browser.call("Page.printToPDF", printBackground=True, preferCSSPageSize=True)
    (folder / "report_printed.pdf").write_bytes(base64.b64decode(printed["data"]))
    return wrong


def _faults_of_access(browser: Browser) -> list[str]:
    """Return the serious faults that axe finds for people who cannot see or point; nothing where axe is missing."""
    if importlib.util.find_spec("axe_core_python") is None:
        return []
    script = resources.files("axe_core_python").joinpath("axe.min.js").read_text(encoding="utf-8")
    browser.call("Runtime.evaluate", expression=script)
    found = browser.call("Runtime.evaluate", expression=AXE, awaitPromise=True, returnByValue=True)
    return found["result"]["value"]


def main() -> int:
    if len(sys.argv) not in (2, 3):
        raise SystemExit(__doc__)
    page = Path(sys.argv[1]).resolve()
    folder = Path(sys.argv[2] if len(sys.argv) == 3 else page.parent / "screenshots").resolve()
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:  # its last helper may still write there
        browser = Browser(Path(profile))
        try:
            wrong = look(browser, page, folder)
        finally:
            browser.close()
    for trouble in wrong:
        print(trouble)
    print(f"{len(wrong)} troubles; screenshots in {folder}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
