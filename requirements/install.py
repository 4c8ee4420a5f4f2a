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
"""Installer of the missing locked versions, with progress.

    install.py wheels|sourced|kilted run [test] [docs]

It is run by the environment to be completed, with the standard library alone. A distribution counts as installed when
pip has written its last line about it. What an interrupted run has left incomplete is installed again; the rest is
kept.
"""

from __future__ import annotations

import contextlib
import hashlib
import platform
import re
import shutil
import subprocess
import sys
import sysconfig
import time
from importlib.metadata import Distribution, distributions
from pathlib import Path

HERE = Path(__file__).parent
LOG = Path(sys.prefix) / "install.log"
SITE = sysconfig.get_path("purelib")
ON_DISK_MB = {"run": 300, "wheels": 220, "kilted": 220, "sourced": 70, "kernels": 220, "test": 920, "docs": 220}
"""Upper bound of each part, with the bytecode that Python adds; a test compares it with what is installed."""
TELL_S = 3.0
_PIN = re.compile(r"(?P<name>[\w.-]+)==(?P<version>[\w.]+)(?: ; python_version in \"(?P<pythons>[\d. ]+)\")?")
_FETCHED = re.compile(
    r"^ *(?:Downloading|Using cached) ([\w.]+)-\S+(?:whl|gz) \(([\d.]+) (bytes|[kMG]B)\)", re.MULTILINE
)
_UNITS_MB = {"bytes": 1e-6, "kB": 1e-3, "MB": 1.0, "GB": 1e3}


def pins(part: str) -> dict[str, str]:
    """Return name -> version of a part of the lock for this Python."""
    text = (HERE / f"{part}.txt").read_text(encoding="utf-8")
    here = ".".join(platform.python_version_tuple()[:2])
    found = [match for match in map(_PIN.match, text.splitlines()) if match]
    return {pin["name"]: pin["version"] for pin in found if here in (pin["pythons"] or here).split()}


def installed() -> dict[str, Distribution]:
    """Return the complete distributions in this environment, by name."""
    found = distributions(path=[SITE, sysconfig.get_path("platlib")])
    complete = (one for one in found if one.name and "INSTALLER," in (one.read_text("RECORD") or ""))
    return {re.sub(r"[-_.]+", "-", one.name).lower(): one for one in complete}


def size_mb(distribution: Distribution) -> float:
    """Return the size of a distribution's files."""
    return sum(file.size or 0 for file in distribution.files or ()) / 1e6


def forget_halves() -> None:
    """Let pip install interrupted distributions again: it takes a directory of metadata for a complete one."""
    for metadata in Path(SITE).glob("*.dist-info"):
        record = metadata / "RECORD"
        if not record.exists() or "INSTALLER," not in record.read_text(encoding="utf-8"):
            shutil.rmtree(metadata)


def say(text: str) -> None:
    """Print a line immediately."""
    print(text, flush=True)  # noqa: T201  # a program


def progress(asked: dict[str, str]) -> str:
    """Return the progress of pip, from its output and from the installed distributions."""
    text = LOG.read_text(encoding="utf-8", errors="replace")
    fetched = _FETCHED.findall(text)
    if "Installing collected packages" not in text:
        size = sum(float(number) * _UNITS_MB[unit] for _, number, unit in fetched)
        return f"fetched {len(fetched)} of {len(asked)} packages, {size:.0f} MB" + (
            f": {fetched[-1][0]}" if fetched else ""
        )
    there = installed()
    done = [there[name] for name, version in asked.items() if name in there and there[name].version == version]
    return f"installed {len(done)} of {len(asked)} packages, {sum(map(size_mb, done)):.0f} MB"


def install(asked: dict[str, str]) -> int:
    """Run pip, report the progress every few seconds, and return its exit code."""
    requirements = LOG.with_suffix(".txt")
    lines = [f"{name}=={version}" for name, version in asked.items()]
    requirements.write_text("\n".join(["--only-binary :all:", "--no-binary empy", *lines, ""]), encoding="utf-8")
    # Python compiles modules at import: compiling all of them here would take half a minute
    options = ["--no-deps", "--no-compile", "--no-input", "--disable-pip-version-check", "--progress-bar", "off"]
    command = [sys.executable, "-u", "-m", "pip", "install", *options, "--requirement", str(requirements)]
    with LOG.open("w") as log, subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT) as pip:  # noqa: S603  # own arguments
        while True:
            try:
                return pip.wait(TELL_S)
            except subprocess.TimeoutExpired:
                say(f"  {progress(asked)}")


def link_equal_files() -> None:
    """Store files of equal content once: wheels contain no links, and ROS libraries have up to eight names each.

    A later installation by pip replaces a file; it does not write into it.
    """
    sizes: dict[int, list[Path]] = {}
    for path in Path(sys.prefix).rglob("*.so*"):
        if path.is_file() and not path.is_symlink():
            sizes.setdefault(path.stat().st_size, []).append(path)
    for same_size in sizes.values():
        first: dict[bytes, Path] = {}
        for path in same_size if len(same_size) > 1 else ():
            kept = first.setdefault(hashlib.sha256(path.read_bytes()).digest(), path)
            if not kept.samefile(path):
                with contextlib.suppress(OSError):  # without support for links, all copies are kept
                    path.with_name(f"{path.name}.link").hardlink_to(kept)
                    path.with_name(f"{path.name}.link").replace(path)


def main() -> int:
    """Install the requested parts; return the exit code."""
    ros, *tiers = sys.argv[1:]
    parts = [part for tier in tiers for part in {"run": ("run", ros), "test": ("test", "kernels")}.get(tier, (tier,))]
    wanted = {name: version for part in parts for name, version in pins(part).items()}
    forget_halves()
    there = installed()
    missing = {name: version for name, version in wanted.items() if name not in there or there[name].version != version}
    if not missing:
        link_equal_files()  # unless an interrupted run has done so
        return 0
    begin = time.monotonic()
    cost = sum(ON_DISK_MB[part] for part in parts if not pins(part).keys() <= there.keys())
    source = {"wheels": "ROS 2 from PyPI wheels", "kilted": "ROS 2 Kilted from PyPI wheels"}.get(
        ros, "the sourced ROS 2"
    )
    say(
        f"{Path(sys.prefix).name}: installing {len(missing)} of {len(wanted)} packages ({', '.join(tiers)}) for Python "
        f"{platform.python_version()} and {source}: up to {cost} MB on disk, less than half of it to "
        "download, a minute or two"
    )
    try:
        code = install(missing)
    except KeyboardInterrupt:
        say("interrupted; the same command goes on where this one stopped")
        return 130
    if code:
        lines = LOG.read_text(encoding="utf-8", errors="replace").splitlines()
        say("\n".join(line for line in lines if line.startswith("ERROR")) or "\n".join(lines[-5:]))
        say(f"pip could not install everything, see {LOG}; the same command goes on where this one stopped")
        return code
    link_equal_files()
    say(f"  installed {len(missing)} packages in {time.monotonic() - begin:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
