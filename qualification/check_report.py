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
"""Test of a report's legibility in a browser: overlapping labels, small text, overflow, requests, accessibility.

    python -m qualification.check_report runs/campaign_paper/report.html [SCREENSHOTS]

It needs Chromium (`apt-get install chromium`); axe checks accessibility. It takes screenshots 1280 and 400 pixels wide,
light and dark, and a PDF of the printed page, and writes them to the second argument (default: next to the report). The
exit code is 1 if a problem is found.
"""

from __future__ import annotations

import argparse
import base64
import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "test"))

from kits.browser import Browser, Page, serious_faults

VIEWS = ((1280, "light"), (1280, "dark"), (400, "light"), (400, "dark"))
LEAST_TEXT_PX = 9.0
LONGEST_PX = 16_000  # longest screenshot: longer ones cost gigabytes

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


@contextlib.contextmanager
def shown(browser: Browser, file: Path, width: int, scheme: str) -> Iterator[Page]:
    """Show a file in a window of this width [px], light or dark."""
    page = browser.page(width, 900, prefers_color_scheme=scheme)
    page.call("Emulation.setScrollbarsHidden", hidden=True)  # scroll bars of a phone take no room
    page.goto(file.as_uri())
    try:
        yield page
    finally:
        page.close()


def troubles(page: Page) -> list[str]:
    """Return the problems of the page that is shown."""
    own = page.js("location.href")
    return [
        *page.js(TROUBLES),
        *serious_faults(page),
        *(f"asks for {address}" for address in page.fetched if address != own and not address.startswith("data:")),
        *(f"console: {error}" for error in page.errors),
    ]


def main() -> int:
    """Print the problems in every view, and keep the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("report", type=Path, help="the HTML file of the report")
    parser.add_argument("screenshots", nargs="?", type=Path, help="folder (default: next to the report)")
    arguments = parser.parse_args()
    file = arguments.report.resolve()
    folder = (arguments.screenshots or file.parent / "screenshots").resolve()
    folder.mkdir(parents=True, exist_ok=True)
    wrong = []
    with contextlib.closing(Browser()) as browser:
        for width, scheme in VIEWS:
            with shown(browser, file, width, scheme) as page:
                wrong += [f"{width} px, {scheme}: {trouble}" for trouble in troubles(page)]
                height = min(page.js("document.documentElement.scrollHeight"), LONGEST_PX)
                clip = {"x": 0, "y": 0, "width": width, "height": height, "scale": 1}
                picture = page.call("Page.captureScreenshot", format="png", clip=clip, captureBeyondViewport=True)
                (folder / f"report_{width}_{scheme}.png").write_bytes(base64.b64decode(picture["data"]))
        with shown(browser, file, *VIEWS[0]) as page:
            printed = page.call("Page.printToPDF", printBackground=True, preferCSSPageSize=True)
            (folder / "report_printed.pdf").write_bytes(base64.b64decode(printed["data"]))
    sys.stdout.write("".join(f"{trouble}\n" for trouble in wrong))
    sys.stdout.write(f"{len(wrong)} problems; pictures in {folder}\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
