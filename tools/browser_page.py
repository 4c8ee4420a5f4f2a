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
"""Build of the rig in a browser: `python -m tools.browser_page [DIRECTORY]` (default: build/rig).

`DIRECTORY/index.html` contains everything and opens from disk. `DIRECTORY/served` contains the module, the snapshots
and the scripts as separate files, for pages that embed the rig.
"""

from __future__ import annotations

import argparse
import base64
import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from impact_rig.embedded.snapshot import snapshot
from impact_rig.embedded.wasm import build_wasm
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig_lab.server import plotter_files

ROOT = Path(__file__).parents[1]
SITE, LAB = ROOT / "impact_rig_lab" / "site", ROOT / "impact_rig_lab" / "static"
LAWS = ("flores", "hertz", "kelvin_voigt", "walton_braun")
RESTITUTIONS = (0.35, 0.6, 0.8)
MOST_BYTES = 3_000_000


def presets() -> dict[str, bytes]:
    """Return the snapshots that the page offers, the paper's rig first."""
    found = {"paper's rig": snapshot(RigConfig())}
    for law in LAWS:
        for e in RESTITUTIONS:
            changes = {"contact.law": law, "contact.restitution": e}
            found[f"{law}, e = {e:g}"] = snapshot(from_flat(RigConfig(), changes))
    return found


def modules() -> Iterator[tuple[str, str]]:
    """Yield name and text of each script; the scripts of the lab and the site import each other by these names."""
    for prefix, folder in (("lab", LAB), ("site", SITE)):
        for path in sorted(folder.glob("*.js")):
            text = re.sub(r'from "\./(\w+\.js)"', rf'from "{prefix}/\1"', path.read_text(encoding="utf-8"))
            yield f"{prefix}/{path.name}", text


def page(module: bytes, snapshots: dict[str, bytes]) -> str:
    """Return the page with all its parts."""
    scripts = dict(modules())
    wanted = ("lab/format.js", "lab/motion.js", "lab/page.js", "lab/paper.js", "lab/rigview.js", "lab/scopeview.js")
    wanted += ("lab/spectrumview.js", "site/signals.js")
    urls = {name: f"data:text/javascript,{quote(scripts[name])}" for name in wanted}
    # workers do not support import maps: the two scripts of the worker become one
    worker = re.sub(r"^export ", "", scripts["site/rig.js"], flags=re.MULTILINE)
    worker += re.sub(r"^import .*\n", "", scripts["site/worker.js"], flags=re.MULTILINE)
    given = {
        "module": base64.b64encode(module).decode(),
        "snapshots": {name: base64.b64encode(data).decode() for name, data in snapshots.items()},
        "worker": worker,
    }
    plotter = plotter_files()
    library = plotter / "uPlot.iife.js"
    styles = (plotter / "uPlot.min.css").read_text() + (LAB / "style.css").read_text(encoding="utf-8")
    text = json.dumps(given).replace("</", "<\\/")  # ends no script
    begin = f"""
const given = {text};
const bytes = (text) => Uint8Array.from(atob(text), (one) => one.charCodeAt(0)).buffer;
globalThis.site = {{
  worker: new Worker(URL.createObjectURL(new Blob([given.worker], {{ type: "text/javascript" }}))),
  start: {{ module: bytes(given.module), snapshots: {{}} }},
}};
for (const [name, one] of Object.entries(given.snapshots)) site.start.snapshots[name] = bytes(one);
"""
    parts = {
        "<!-- styles -->": f"<style>{styles}</style>",
        "<!-- scripts -->": f'<script type="importmap">{json.dumps({"imports": urls})}</script>\n'
        f"<script>{library.read_text()}</script>\n<script>{begin}</script>\n"
        f'<script type="module">{scripts["site/site.js"]}</script>',
    }
    text = (SITE / "index.html").read_text(encoding="utf-8")
    for place, part in parts.items():
        text = text.replace(place, part)
    return text


def build(directory: Path) -> Path:
    """Build the page and its files; return the page."""
    served = directory / "served"
    shutil.rmtree(directory, ignore_errors=True)
    served.mkdir(parents=True)
    build_wasm(served / "rig.wasm", ROOT / "build" / "kernels")
    snapshots = presets()
    for name, data in snapshots.items():
        (served / f"{re.sub(r'[^a-z0-9]+', '_', name)}.rig").write_bytes(data)
    for name in ("rig.js", "worker.js"):
        shutil.copy2(SITE / name, served)
    found = directory / "index.html"
    found.write_text(page((served / "rig.wasm").read_bytes(), snapshots), encoding="utf-8")
    if found.stat().st_size > MOST_BYTES:
        raise SystemExit(f"{found} has {found.stat().st_size} bytes, more than {MOST_BYTES}")
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("directory", nargs="?", type=Path, default="build/rig", help="destination (default: build/rig)")
    made = build(parser.parse_args().directory)
    print(f"{made}: {made.stat().st_size} bytes")  # noqa: T201  # a program
