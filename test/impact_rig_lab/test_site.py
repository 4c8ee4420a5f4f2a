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
"""The rig in a browser: one file, from disk, with the readings of the rig in Python."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from impact_rig import kernels
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat

if TYPE_CHECKING:
    from kits.browser import Browser

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))  # the tool is no part of the package
for needed in ("ziglang", "llvmlite", "aiohttp", "uplot"):
    pytest.importorskip(needed)
from kits.browser import serious_faults  # noqa: E402
from kits.shared import shared  # noqa: E402

from tools import browser_page  # noqa: E402

pytestmark = [
    pytest.mark.skipif(kernels.MODE != "library", reason="kernels run otherwise here"),
    pytest.mark.timeout(900),  # translates where `make` has left nothing
]
SECONDS = 10


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return shared(tmp_path_factory, "rig_page", browser_page.build) / "index.html"


def readings(gap_m: float, frequency_hz: float) -> str:
    """SHA-256 of the readings of the rig in Python, channel by channel."""
    rig = Rig(from_flat(RigConfig(), {"barriers.gap_m": gap_m}))
    rig.accept(frequency_hz, 0.52)
    rows = np.concatenate([block.scan.rows for block in rig.advance(SECONDS * 1_000_000_000)])
    names = [name for name in rows.dtype.names or () if name not in ("time", "status")]
    return hashlib.sha256(b"".join(np.ascontiguousarray(rows[name]).tobytes() for name in names)).hexdigest()


def test_the_page_opened_from_disk_yields_the_readings_of_the_rig(page_file: Path, browser: Browser) -> None:
    page = browser.page()
    page.goto(page_file.as_uri())
    page.wait("document.getElementById('word').textContent === 'running'", "the rig to run")
    page.wait("lab.now.scans > 20000 && document.getElementById('dt').textContent !== '–'", "two seconds and DT")
    assert 10.0 < float(page.text("#dt")) < 150.0
    assert page.js("lab.motion.states.length") > 500
    for gap_mm, frequency in ((6, 9.1), (2, 9.1), (2, 8.7), (6, 8.7)):
        page.write("#frequency", f"{frequency}")
        page.write("#gap", f"{gap_mm}")
        page.js(f"lab.digest = null; site.worker.postMessage({{type: 'digest', seconds: {SECONDS}}})")
        found = page.wait("lab.digest", "the digest")
        assert found["hash"] == readings(gap_mm / 1000, frequency)
        assert found["scans"] == SECONDS * 10_000
    assert page.faults() == []
    assert all(url.startswith(("file:", "data:", "blob:")) for url in page.fetched)


def test_the_page_has_no_accessibility_faults(page_file: Path, browser: Browser) -> None:
    page = browser.page(400, 900, prefers_color_scheme="dark")
    page.goto(page_file.as_uri())
    page.wait("lab.now.scans > 0", "the rig to run")
    assert serious_faults(page) == []
    assert page.js("document.documentElement.scrollWidth") <= 400
    page.write("#gap", "1000000")
    page.wait("document.getElementById('answer').textContent.includes('gap is out of range')", "the answer")


def test_the_page_follows_window_size_and_colour_preference_while_it_runs(page_file: Path, browser: Browser) -> None:
    """A narrowed page must not scroll sideways, and colours must change with the preference."""
    page = browser.page(1440, 900)
    page.goto(page_file.as_uri())
    page.wait("lab.now.scans > 0", "the rig to run")
    page.size(400, 900)
    page.wait("document.querySelector('#scope canvas').clientWidth < 400", "the scope to become narrow")
    assert page.js("document.documentElement.scrollWidth") <= 400
    assert page.js("document.documentElement.dataset.theme") != "dark"
    page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}])
    page.wait("document.documentElement.dataset.theme === 'dark'", "the dark colours")


def test_every_view_fits_its_panel(page_file: Path, browser: Browser) -> None:
    """The scope must not cover the spectrum, nor may the frequencies below it be cut off, at any width of the page."""
    page = browser.page(1440, 900)
    page.goto(page_file.as_uri())
    page.wait("lab.now.scans > 0", "the rig to run")
    for width in (1440, 1650, 1100, 800, 600, 400):
        page.size(width, 900)
        page.wait(f"innerWidth === {width}", "the width")
        for view in ("settings", "rig", "scope", "spectrum"):
            inside = f"""(() => {{ const view = document.getElementById('{view}'), panel = view.closest('section');
                const outer = panel.getBoundingClientRect(), inner = view.getBoundingClientRect();
                const others = [...document.querySelectorAll('main section')].filter((one) => one !== panel);
                return inner.width > 150 && inner.bottom <= outer.bottom && inner.right <= outer.right &&
                    others.every((one) => {{ const other = one.getBoundingClientRect();
                        return other.top >= outer.bottom || other.bottom <= outer.top || other.left >= outer.right ||
                            other.right <= outer.left; }}); }})()"""
            page.wait(inside, f"{view} to be inside its panel at {width} pixels")
