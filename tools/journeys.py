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
"""Run what README and docs show, each command in the environment that its page names: `make journeys`.

The table is `test/journeys/journeys.yaml`. Every environment begins as a reader's does: a fresh clone of the last
commit or an empty directory, an empty home, virtual environments of its own. `test/journeys` holds the table against
the pages, and runs the cheap steps on the working tree with `--thorough`.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import attrs
import yaml

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tools.check_docs import Block, pages  # noqa: E402

TABLE = ROOT / "test" / "journeys" / "journeys.yaml"
CLONE, TEST, JAZZY = "clone", "test", "jazzy"
ENVIRONMENTS = {
    CLONE: "a fresh clone, in which `make` sets up `.venv`",
    TEST: "the tests' part of `.venv`, which `make test` installs",
    JAZZY: "Environment: a shell in which ROS 2 Jazzy is sourced.",
    "wheel[lab]": "Environment: the installed package with the extra `[lab]`, or a clone.",
    "wheel[import]": "Environment: the installed package with the extra `[import]`; ROS 2 is not needed.",
    "wheel[wheels,strategies]": "Environment: the installed package with the extras `[wheels,strategies]`",
}
"""Environments of the table, each with the words by which a page names it."""
OTHERS = "*"
DOMAIN = "75"
"""ROS domain of the journeys: not that of `make`, where somebody may be at work."""
LIMIT_S = 1200.0
HOST = ("ROS_", "AMENT_", "PYTHON", "VIRTUAL_ENV", "XDG_", "MPL", "IMPACT_RIG", "OPENBLAS", "MAKE", "MFLAGS")


@attrs.frozen(kw_only=True)
class Journey:
    """One command of a page."""

    page: str
    run: str
    environment: str
    before: Sequence[str] = ()  # commands of the page that make what it takes as given
    instead: str = ""  # what is run in its place: the same at its smallest setting
    exit: int = 0
    leaves: Sequence[str] = ()
    cheap: bool = False
    not_run: str = ""

    @property
    def name(self) -> str:
        """Page and command."""
        return f"{self.page}: {self.run}"


def journeys() -> list[Journey]:
    """Return the table."""
    table = yaml.safe_load(TABLE.read_text(encoding="utf-8"))
    return [
        Journey(
            page=page,
            before=about.get("before", ()),
            **{**step, "environment": step.get("environment", about["environment"])},
        )
        for page, about in table.items()
        for step in about["steps"]
    ]


def commands_of(block: Block) -> Iterator[str]:
    """Give the commands of a block as they stand there, without remarks."""
    for line in block.content.replace("\\\n", " ").splitlines():
        words = line.partition(" #")[0].strip()
        if words and not words.startswith("#"):
            yield from (" ".join(part.split()) for part in words.split("&&"))


def faults() -> list[str]:
    """Return commands without a journey, journeys without a command, and pages that do not name their environment."""
    table = journeys()
    found = []
    for name, page in pages().items():
        said = [command for block in page.blocks if block.language == "sh" for command in commands_of(block)]
        known = [one.run for one in table if one.page == name]
        if OTHERS not in known:
            found += [
                f"{name}: {command}: it has no journey in {TABLE.name}" for command in said if command not in known
            ]
        found += [f"{name}: {run}: the page has no such command" for run in known if run not in (*said, OTHERS)]
        text = " ".join((ROOT / name).read_text(encoding="utf-8").split())
        for environment in {one.environment for one in table if one.page == name}:
            if ENVIRONMENTS[environment] not in text:
                found.append(f"{name}: it does not say {ENVIRONMENTS[environment]!r}")
    return found


class Places:
    """Environments, each made once.

    Args:
        folder: holds them, with an empty home.
        source: repository that is cloned; None: the working tree is copied, and what is there already is kept.
    """

    def __init__(self, folder: Path, source: Path | None) -> None:
        self.folder, self._source = folder, source
        self.home = folder / "home"
        shutil.rmtree(self.home, ignore_errors=True)
        self.home.mkdir(parents=True)

    def environment(self, name: str) -> tuple[Path, dict[str, str]]:
        """Return working directory and variables of an environment, made if it is not there."""
        directory, programs = self._clone(name) if name in (CLONE, TEST) else self._wheel(name)
        kept = {key: value for key, value in os.environ.items() if not key.startswith(HOST)}
        own = {"HOME": str(self.home), "PATH": f"{programs}:{os.environ['PATH']}", "ROS_DOMAIN_ID": DOMAIN}
        if programs.parent.name == ".venv" or "wheels" in name:
            own["AMENT_PREFIX_PATH"] = str(programs.parent)
        return directory, {**kept, **own, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "MPLBACKEND": "agg"}

    def _clone(self, name: str) -> tuple[Path, Path]:
        checkout = self.folder / name
        if self._source is not None:
            if not checkout.exists():
                call(["git", "clone", "--quiet", str(self._source), str(checkout)], self.folder)
        else:
            from tools.release import tracked  # noqa: PLC0415  # needs the built package

            files = [*tracked(), *(f"impact_rig/kernels/{one}" for one in ("_library.abi3.so", "impact_rig.h"))]
            for file in files:
                copy(ROOT / file, checkout / file)
        environment = {key: value for key, value in os.environ.items() if not key.startswith(HOST)}
        target = "kernels" if name == CLONE else ".venv/registered"
        wanted = ["make", "--silent", target] if name == CLONE else ["make", "--silent", "venv"]
        call(wanted, checkout, {**environment, "HOME": str(self.home)})
        return checkout, checkout / ".venv" / "bin"

    def _wheel(self, name: str) -> tuple[Path, Path]:
        extras = name.removeprefix("wheel")
        key = hashlib.sha256((name + (ROOT / "setup.py").read_text(encoding="utf-8")).encode()).hexdigest()[:8]
        place = self.folder / f"{name.replace('[', '_').replace(',', '_').rstrip(']')}_{key}"
        programs = place / "venv" / "bin"
        from tools.release import build  # noqa: PLC0415  # as above

        with tempfile.TemporaryDirectory() as made:
            _, wheel = build(Path(made), ROOT / "impact_rig" / "kernels")
            if not (place / "ready").exists():
                call([sys.executable, "-m", "venv", "--clear", str(programs.parent)], self.folder)
                call([str(programs / "python"), "-m", "pip", "install", "--quiet", f"{wheel}{extras}"], self.folder)
                (place / "ready").touch()
            else:
                again = ["--quiet", "--no-deps", "--no-index", "--force-reinstall", str(wheel)]
                call([str(programs / "python"), "-m", "pip", "install", *again], self.folder)
        work = place / "work"
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(ROOT / "config", work / "config")
        return work, programs


def copy(source: Path, target: Path) -> None:
    """Copy a file where it is new; what has not changed keeps its time, so that make leaves it alone."""
    if not target.exists() or target.read_bytes() != source.read_bytes():
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(source, target)


def call(command: Sequence[str], directory: Path, environment: dict[str, str] | None = None) -> None:
    """Run a command.

    Raises:
        RuntimeError: it failed; with its last words.
    """
    done = subprocess.run(  # noqa: S603  # our own commands
        command, cwd=directory, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} failed\n{done.stdout[-2000:]}{done.stderr[-2000:]}")


def prepare(journey: Journey, place: tuple[Path, dict[str, str]]) -> None:
    """Make what a page takes as given, in its environment."""
    directory, environment = place
    for command in journey.before:
        call(["bash", "-c", command], directory, environment)


def travel(journey: Journey, place: tuple[Path, dict[str, str]]) -> str:
    """Run a journey; return what was wrong, or nothing."""
    directory, environment = place
    try:
        done = subprocess.run(  # noqa: S603  # our own pages
            ["bash", "-c", journey.instead or journey.run],  # noqa: S607  # the one that a reader has
            cwd=directory, env=environment, capture_output=True, text=True, check=False, timeout=LIMIT_S,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"it did not end within {LIMIT_S:g} s"
    if done.returncode != journey.exit:
        words = f"{done.stdout[-2000:]}{done.stderr[-2000:]}"
        return f"exit code {done.returncode}, expected {journey.exit}\n{words}"
    missing = [name for name in journey.leaves if not (directory / name).exists()]
    return f"it left no {', '.join(missing)}" if missing else ""


def main() -> int:
    """Run all journeys from nothing and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cheap", action="store_true", help="run the cheap ones only")
    parser.add_argument("pages", nargs="*", metavar="PAGE", help="pages whose journeys are run (default: all)")
    arguments = parser.parse_args()
    wrong = faults()
    print(*wrong, sep="\n", end="\n" if wrong else "")  # noqa: T201  # a program
    with tempfile.TemporaryDirectory(prefix="impact_rig_journeys_") as folder:
        places, prepared = Places(Path(folder), ROOT), set()
        made: dict[str, tuple[Path, dict[str, str]]] = {}
        for journey in journeys():
            if (arguments.cheap and not journey.cheap) or (arguments.pages and journey.page not in arguments.pages):
                continue
            began = time.monotonic()
            if journey.not_run:
                print(f"not run: {journey.name}: {journey.not_run}")  # noqa: T201  # as above
                continue
            if journey.environment not in made:
                made[journey.environment] = places.environment(journey.environment)
                print(f"made {journey.environment}, {time.monotonic() - began:.0f} s", flush=True)  # noqa: T201
            began, place = time.monotonic(), made[journey.environment]
            if journey.page not in prepared:
                prepared.add(journey.page)
                prepare(journey, place)
            fault = travel(journey, place)
            wrong += [f"{journey.name}: {fault}"] if fault else []
            word = "FAILED" if fault else "ok"
            print(f"{word}, {time.monotonic() - began:.0f} s: {journey.name} {fault}", flush=True)  # noqa: T201
    print(f"{len(wrong)} faults")  # noqa: T201  # as above
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
