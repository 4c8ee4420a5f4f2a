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
"""Pictures of docs/how-to/lab.md, taken with Chromium: `python -m tools.lab_pictures` (two minutes).

The page itself draws the animation; Pillow, which is installed with matplotlib, combines its frames.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "test"))

from kits.browser import Browser, Page  # noqa: E402

from impact_rig.client import Client, Processes, isolated_domain  # noqa: E402
from impact_rig.driver.sample_run import make_sample  # noqa: E402
from impact_rig_lab.gateway import OwnedProcesses  # noqa: E402
from impact_rig_lab.live import LiveSource  # noqa: E402
from impact_rig_lab.playback import PlaybackSource  # noqa: E402
from impact_rig_lab.server import Server  # noqa: E402

IMAGES = ROOT / "docs" / "images"
FRAMES, FRAME_MS = 24, 60


def main() -> None:
    """Take all pictures."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    IMAGES.mkdir(parents=True, exist_ok=True)
    with contextlib.closing(Browser()) as browser, tempfile.TemporaryDirectory() as directory:
        live(browser, Path(directory))
        playback(browser, Path(directory))


def live(browser: Browser, directory: Path) -> None:
    """Take the pictures of a live rig: 9.1 Hz, a curve, a trip."""
    parameters = {
        "rig": {"time.peers": ["analysis", "recorder"]},
        "analysis": {"gap_m": 0.006},
        "recorder": {"directory": str(directory)},
    }
    with isolated_domain() as domain_id, Processes(domain_id, directory / "logs", "/rig") as processes:
        source = LiveSource(domain_id, "/rig", OwnedProcesses(processes, parameters))
        with Server(source, port=0) as server, source, Client(domain_id, "rig", name="observer") as client:
            client.wait_active("rig", "analysis", "recorder")
            light = browser.page(1280, 800, prefers_color_scheme="light")
            light.goto(server.address)
            light.wait("window.lab && lab.now.rig?.word === 'at rest' && lab.drawn.pictures > 2", "a rig at rest")
            picture(light, "lab_rest")
            for gap, frequency in ((4, 9.1), (6, 8.7), (6, 8.9), (6, 9.3), (6, 9.1)):
                light.click(f"[data-mark='gap-{gap}']")
                light.wait("!document.querySelector('.pending')", "the gap")
                count = light.js("lab.now.dt.length")
                light.write("#knob-frequency", str(frequency))
                light.write("#knob-current", "0.52")
                light.wait(
                    f"lab.now.rig.word === 'measured' && lab.now.dt.length > {count} && "
                    f"lab.now.dt.at(-1).f === {frequency} && lab.now.dt.at(-1).settled",
                    "a settled measurement", 90.0,
                )  # fmt: skip
            picture(light, "lab")
            animation(light)
            for name, width, height, scheme, drawn in (
                ("lab_1920_dark", 1920, 1080, "dark", 40), ("lab_400", 400, 860, "light", 20),
            ):  # fmt: skip
                other = browser.page(width, height, prefers_color_scheme=scheme)
                other.goto(server.address)
                other.wait(f"window.lab && lab.drawn.pictures > {drawn}", "traces")
                picture(other, name)
            light.write("#knob-current", "14")
            light.wait("lab.now.rig.word === 'tripped'", "a trip")
            light.wait("lab.now.rig.text.includes('latched')", "its words")
            picture(light, "lab_tripped")


def playback(browser: Browser, directory: Path) -> None:
    """Take the pictures of the sample run, paused at an impact."""
    source = PlaybackSource([make_sample(directory / "sample")])
    with Server(source, port=0) as server, source:
        page = browser.page(1280, 800, prefers_color_scheme="light")
        page.goto(server.address)
        page.wait("window.lab && lab.now.playback?.read === 1 && lab.now.impact_marks?.some(n => n)", "the marks")
        page.js("lab.link.ask('play', {value: false})")
        page.js("lab.link.ask('seek', {value: 14.2})")
        page.wait("Math.abs(lab.now.playback.now - 14.2) < 0.01 && lab.now.dt.length > 0", "the instant")
        page.wait("document.getElementById('dt-number').textContent !== '–'", "the measurement")
        page.wait("lab.spectrum.plot.data[0].length > 100", "the spectrum")
        picture(page, "lab_playback")


def picture(page: Page, name: str) -> None:
    """Take a picture after everything has been drawn."""
    page.js("document.activeElement.blur()")
    page.js("new Promise(done => setTimeout(done, 400))")
    file = IMAGES / f"{name}.png"
    page.picture(file)
    Image.open(file).convert("P", palette=Image.Palette.ADAPTIVE, colors=128).save(file, optimize=True)
    sys.stdout.write(f"{name}\n")


def animation(page: Page) -> None:
    """Combine pictures of the rig in slow motion."""
    page.click("[data-slow='0.02']")
    corners = "const b = document.getElementById('rig').getBoundingClientRect(); return [b.x, b.y, b.right, b.bottom];"
    box = page.js(f"(() => {{ {corners} }})()")
    frames = []
    for _ in range(FRAMES):
        page.js("new Promise(done => setTimeout(done, 120))")
        with tempfile.NamedTemporaryFile(suffix=".png") as file:
            page.picture(Path(file.name))
            whole = Image.open(io.BytesIO(Path(file.name).read_bytes()))
        frames.append(whole.crop(tuple(box)).convert("P", palette=Image.Palette.ADAPTIVE, colors=32))
    frames[0].save(
        IMAGES / "lab.gif", save_all=True, append_images=frames[1:], duration=FRAME_MS, loop=0, optimize=True
    )
    page.click("[data-slow='1']")
    sys.stdout.write("lab.gif\n")


if __name__ == "__main__":
    main()
