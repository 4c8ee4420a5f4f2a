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
"""Commands of README and docs, each run in the environment that its page names: `make journeys`.

The table is `test/journeys/journeys.yaml`. Every environment is that of a new reader: a fresh clone of the last commit
or an empty directory, an empty home, and its own virtual environments. The output of the commands is kept in
`build/journeys.txt`; a result that is not a number is a failure. `test/journeys` compares the table with the pages and
runs the cheap journeys of the working tree, in environments made from what the tests have installed.
"""

from __future__ import annotations

import argparse
import os
import re
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

from tools.check_docs import Block, Page, pages  # noqa: E402
from tools.doc_commands import PROGRAMS, command_faults, commands  # noqa: E402
from tools.environments import assemble, closure, install, pinned  # noqa: E402

TABLE = ROOT / "test" / "journeys" / "journeys.yaml"
CLONE, TEST, JAZZY = "clone", "test", "jazzy"
ENVIRONMENTS = {
    CLONE: "a clone of the repository",
    TEST: "`make venv`",
    JAZZY: "a shell in which ROS 2 Jazzy is sourced",
    "wheel": "the installed package",
    "wheel[lab]": "Environment: the installed package with the extra `[lab]`",
    "wheel[import]": "Environment: the installed package with the extra `[import]`; ROS 2 is not needed.",
    "wheel[wheels,strategies]": "Environment: the installed package with the extras `[wheels,strategies]`",
}
"""Environments of the table, each with the phrase by which a page names it."""
OUTPUT = ROOT / "build" / "journeys.txt"
NOT_A_NUMBER = re.compile(r'^(?!\s*"doc":).*\b(nan|inf)\b', re.IGNORECASE)
"""A line with a result of nan or inf; the interface's own description may mention them."""
PLACEHOLDER = re.compile(r"(?<![\w=])(?!(ARGS|ONLY|SHUFFLE|ROS|SECONDS|MEMORY_S|IMPACT_RIG_HOSTILE)=)\[?[A-Z]{2,}\b|…")
"""Words that a reader replaces: a command in running text with one of them cannot be run literally."""
DOMAIN = "75"
"""ROS domain of the journeys, different from that of `make`, which another terminal may be using."""
LIMIT_S = 1200.0
HOST = ("ROS_", "AMENT_", "PYTHON", "VIRTUAL_ENV", "XDG_", "MPL", "IMPACT_RIG", "OPENBLAS", "MAKE", "MFLAGS", "ARGS")
"""Beginnings of variables that journeys do not inherit; `make journeys ARGS=PAGE` exports ARGS to each inner `make`."""


@attrs.frozen(kw_only=True)
class Journey:
    """One command of a page."""

    page: str
    run: str
    environment: str
    before: Sequence[str] = ()  # commands of the page whose results it needs
    instead: str = ""  # command that is run in its place: the same with its smallest setting
    exit: int = 0
    leaves: Sequence[str] = ()
    cheap: bool | str = False  # a command: `make test` runs it, with a setting that is smaller still
    not_run: str = ""

    @property
    def name(self) -> str:
        """Page, command and environment."""
        return f"{self.page}: {self.run} [{self.environment}]"

    def command(self, *, is_cheap: bool = False) -> str:
        """Return the command that `make journeys` runs, or with `is_cheap` that of `make test`."""
        return self.cheap if is_cheap and isinstance(self.cheap, str) else self.instead or self.run


def journeys() -> list[Journey]:
    """Return the table."""
    table = yaml.safe_load(TABLE.read_text(encoding="utf-8"))
    return [
        Journey(
            page=page,
            **{"before": about.get("before", ()), "environment": about["environment"], **step, "run": run},
        )
        for page, about in table.items()
        for step in about["steps"]
        for run in ([step["run"]] if isinstance(step["run"], str) else step["run"])
    ]


def commands_of(block: Block) -> Iterator[str]:
    """Yield the commands of a block literally, without comments."""
    for line in block.content.replace("\\\n", " ").splitlines():
        words = line.partition(" #")[0].strip()
        if words and not words.startswith("#"):
            yield from (" ".join(part.split()) for part in words.split("&&"))


def in_text(page: Page) -> Iterator[str]:
    """Yield the commands in a page's running text that can be run literally."""
    for _, text in page.words:
        if set(text.split()).isdisjoint(PROGRAMS) or PLACEHOLDER.search(text):
            continue
        for words in commands(text):
            if words[0] in PROGRAMS.keys() - {"ros2"} and len(words) > 1 and not any(command_faults(words, whole=True)):
                yield text
                break


def faults() -> list[str]:
    """Return commands without a journey, journeys without a command, and pages that do not name their environment."""
    table = journeys()
    known = {one.run for one in table}
    found = []
    for name, page in pages().items():
        if name.startswith("docs/decisions/"):  # they report what was run, and give no instructions
            continue
        shown = [command for block in page.blocks if block.language == "sh" for command in commands_of(block)]
        own = [one.run for one in table if one.page == name]
        found += [f"{name}: {command}: no journey in {TABLE.name}" for command in shown if command not in own]
        found += [f"{name}: {text}: no journey in {TABLE.name}" for text in in_text(page) if text not in known]
        shown += in_text(page)
        found += [f"{name}: {run}: the page has no such command" for run in own if run not in shown]
        text = " ".join((ROOT / name).read_text(encoding="utf-8").split())
        for environment in {one.environment for one in table if one.page == name}:
            if ENVIRONMENTS[environment] not in text:
                found.append(f"{name}: it does not say {ENVIRONMENTS[environment]!r}")
        if shown and not any(words in text for words in ENVIRONMENTS.values()):
            found.append(f"{name}: it names no environment for {shown[0]}")
    return found


class Places:
    """Runner of environments, each of which is made once.

    Args:
        folder: folder for the environments, with an empty home.
        is_offline: whether they are made from the working tree and this environment's distributions, in seconds.
        wheel: wheel to install; default: it is built when it is needed.
    """

    def __init__(self, folder: Path, *, is_offline: bool = False, wheel: Path | None = None) -> None:
        self.folder, self._is_offline = folder, is_offline
        self.home = folder / "home"
        self.home.mkdir(parents=True)
        self._made: dict[str, tuple[Path, dict[str, str]]] = {}
        self._built = wheel

    def environment(self, name: str) -> tuple[Path, dict[str, str]]:
        """Return working directory and variables of an environment, made if it does not exist."""
        if name not in self._made:
            make = self._clone if name in (CLONE, TEST) else self._wheel
            directory, programs = make(name)
            own = {"HOME": str(self.home), "PATH": f"{programs}:{os.environ['PATH']}", "ROS_DOMAIN_ID": DOMAIN}
            if name in (CLONE, TEST) or "wheels" in name:
                own["AMENT_PREFIX_PATH"] = str(programs.parent)
            own |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "MPLBACKEND": "agg"}
            self._made[name] = directory, {**of_host(), **own}
        return self._made[name]

    def _clone(self, name: str) -> tuple[Path, Path]:
        checkout = self.folder / name
        programs = checkout / ".venv" / "bin"
        if self._is_offline:
            checkout.mkdir()
            for path in ROOT.iterdir():
                if path.name not in {".venv", "build", "runs"}:
                    (checkout / path.name).symlink_to(path)
            assemble(programs.parent, closure([*pinned("run"), *pinned("wheels"), "impact_rig"]))
        else:
            call(["git", "clone", "--quiet", str(ROOT), str(checkout)], self.folder)
            target = "kernels" if name == CLONE else "venv"
            call(["make", "--silent", target], checkout, {**of_host(), "HOME": str(self.home)})
        return checkout, programs

    def _wheel(self, name: str) -> tuple[Path, Path]:
        from tools.release import build  # noqa: PLC0415  # needs the built package

        extras = name.removeprefix("wheel")
        place = self.folder / re.sub(r"\W", "_", name)
        programs = place / "venv" / "bin"
        self._built = self._built or build(self.folder / "release", ROOT / "impact_rig" / "kernels")[1]
        if self._is_offline:
            assemble(programs.parent, closure([f"impact_rig{extras}"]) - {"impact-rig"})
            install(programs.parent, self._built)
        else:
            call([sys.executable, "-m", "venv", str(programs.parent)], self.folder)
            call([str(programs / "python"), "-m", "pip", "install", "--quiet", f"{self._built}{extras}"], self.folder)
        (place / "work").mkdir()
        return place / "work", programs


def of_host() -> dict[str, str]:
    """Return the variables of this process that a reader's shell would have."""
    return {key: value for key, value in os.environ.items() if not key.startswith(HOST)}


def call(command: Sequence[str], directory: Path, environment: dict[str, str] | None = None) -> None:
    """Run a command.

    Raises:
        RuntimeError: it failed; the message contains the end of its output.
    """
    done = subprocess.run(  # noqa: S603  # our own commands
        command, cwd=directory, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} failed\n{done.stdout[-2000:]}{done.stderr[-2000:]}")


def prepare(journey: Journey, place: tuple[Path, dict[str, str]]) -> None:
    """Prepare an environment as a page assumes it: the files that the page shows, and the inputs of its commands."""
    directory, environment = place
    for block in pages()[journey.page].blocks:
        title = block.info.removeprefix("title=")
        if title != block.info and "/" not in title:
            (directory / title).write_text(block.content, encoding="utf-8")
    for command in journey.before:
        call(["bash", "-c", command], directory, environment)


def travel(journey: Journey, place: tuple[Path, dict[str, str]], *, is_cheap: bool = False) -> tuple[str, str]:
    """Run a journey, or what `make test` runs of it; return the fault, empty if there is none, and the output."""
    directory, environment = place
    try:
        done = subprocess.run(  # noqa: S603  # our own pages
            ["bash", "-c", journey.command(is_cheap=is_cheap)],  # noqa: S607  # the one that a reader has
            cwd=directory, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
            timeout=LIMIT_S,
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        return f"it did not end within {LIMIT_S:g} s", str(error.output)
    if done.returncode != journey.exit:
        fault = f"exit code {done.returncode}, expected {journey.exit}\n{done.stdout[-4000:]}"
    elif missing := [name for name in journey.leaves if not (directory / name).exists()]:
        fault = f"it left no {', '.join(missing)}"
    else:
        fault = "\n".join(line for line in done.stdout.splitlines() if NOT_A_NUMBER.search(line))
    return fault, done.stdout


def main() -> int:
    """Run all journeys in new environments and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cheap", action="store_true", help="run only the cheap journeys, with what is installed")
    parser.add_argument("pages", nargs="*", metavar="PAGE", help="pages whose journeys are run (default: all)")
    arguments = parser.parse_args()
    wrong = faults()
    print(*wrong, sep="\n", end="\n" if wrong else "")  # noqa: T201  # a program
    OUTPUT.parent.mkdir(exist_ok=True)
    with (
        tempfile.TemporaryDirectory(prefix="impact_rig_journeys_") as folder,
        OUTPUT.open("w", encoding="utf-8") as output,
    ):
        places, prepared = Places(Path(folder), is_offline=arguments.cheap), set()
        for journey in journeys():
            if (arguments.cheap and not journey.cheap) or (arguments.pages and journey.page not in arguments.pages):
                continue
            if journey.not_run:
                print(f"not run: {journey.name}: {journey.not_run}")  # noqa: T201  # as above
                continue
            began = time.monotonic()
            place = places.environment(journey.environment)
            made_s, began = time.monotonic() - began, time.monotonic()
            if made_s > 1.0:
                print(f"made {journey.environment}, {made_s:.0f} s", flush=True)  # noqa: T201  # as above
            if (journey.page, journey.environment) not in prepared:
                prepared.add((journey.page, journey.environment))
                prepare(journey, place)
            fault, printed = travel(journey, place, is_cheap=arguments.cheap)
            output.write(f"$ {journey.name}\n{printed}\n")
            wrong += [f"{journey.name}: {fault}"] if fault else []
            word = "FAILED" if fault else "ok"
            print(f"{word}, {time.monotonic() - began:.0f} s: {journey.name} {fault}", flush=True)  # noqa: T201
    print(f"{len(wrong)} faults")  # noqa: T201  # as above
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
