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
"""Commands of README and docs, in the environment that each page names; `make journeys` runs all of them."""

from __future__ import annotations

import ast
import json
import re
import shlex
import sys
from importlib.metadata import PackageNotFoundError, distribution, packages_distributions
from pathlib import Path

import pytest

pytest.importorskip("markdown_it", reason="comes with rich, except with Ubuntu's")

from kits.shared import release

from tools import journeys as table
from tools.check_docs import pages
from tools.environments import canonical, closure, pinned
from tools.journeys import ENVIRONMENTS, JAZZY, ROOT, Journey, Places

CHEAP = [one for one in table.journeys() if one.cheap]


def test_every_command_has_a_journey_in_the_environment_of_its_page() -> None:
    assert table.faults() == []


def test_each_journey_is_run_or_states_why_not() -> None:
    for one in table.journeys():
        assert one.environment in ENVIRONMENTS, one.name
        assert one.not_run or one.environment != JAZZY, one.name
        assert not (one.cheap and one.not_run), one.name
        assert not (one.cheap and "make " in one.command(is_cheap=True)), f"{one.name}: it would install"
        assert one.not_run or one.run not in {one.instead, one.cheap}, one.name
    assert {one.environment for one in CHEAP} >= {"clone", "wheel", "wheel[lab]", "wheel[import]"}


def test_a_command_without_a_journey_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    from tools.check_docs import Page

    text = (ROOT / "docs" / "reference" / "instruments.md").read_text(
        encoding="utf-8"
    ) + "\n```sh\nimpact-rig check new.yaml\n```\n"
    monkeypatch.setattr(
        table, "pages", lambda: {"docs/reference/instruments.md": Page.parse("docs/reference/instruments.md", text)}
    )
    assert table.faults() == ["docs/reference/instruments.md: impact-rig check new.yaml: no journey in journeys.yaml"]


def test_every_replacement_for_a_command_exists() -> None:
    from tools.doc_commands import command_faults, commands

    said = {text for one in table.journeys() for text in (one.instead, one.cheap, *one.before) if isinstance(text, str)}
    assert [fault for text in said for words in commands(text) for fault in command_faults(words, whole=True)] == []


def imported(code: str) -> set[str]:
    """Return the packages that a piece of Python imports, without those of Python itself."""
    tree = ast.parse(re.sub(r"^%.*", "", code, flags=re.MULTILINE))
    names = [one.name for node in ast.walk(tree) if isinstance(node, ast.Import) for one in node.names]
    names += [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    return {name.partition(".")[0] for name in names} - sys.stdlib_module_names


def shown_code() -> dict[str, list[str]]:
    """Return the Python code that a page shows or links to, by page."""
    shown = {
        name: [
            one.content
            for one in page.blocks
            if one.language == "python" and ">>>" not in one.content and not one.info.startswith("not run")
        ]
        for name, page in pages().items()
    }
    cells = json.loads((ROOT / "examples" / "recorded_run.ipynb").read_text(encoding="utf-8"))["cells"]
    shown["docs/how-to/notebook.md"] += ["".join(one["source"]) for one in cells if one["cell_type"] == "code"]
    return shown


@pytest.mark.heavy
def test_python_needs_no_more_than_its_page_installs() -> None:
    """The notebook, for example, must not need rosbags, which only the part for tests installs."""
    owners = packages_distributions()
    missing = {}
    for page, codes in shown_code().items():
        text = (ROOT / page).read_text(encoding="utf-8")
        installed = [one for line in re.findall(r"pip install ([^`\n]*)", text) for one in shlex.split(line)]
        extras = [f"impact_rig[{one}]" for one in re.findall(r"\[([a-z,]+)\]`", text)]
        has = closure(
            [*pinned("run"), *pinned("wheels"), "impact_rig", *extras, "pytest"]
            + [one for one in installed if re.fullmatch(r"\w[\w.-]*(\[[\w,-]+\])?", one)]
        )
        own = {Path(one.info.removeprefix("title=")).stem for one in pages()[page].blocks}
        own |= {path.name for path in (*ROOT.glob("impact_rig*"), ROOT / "test" / "kits")}
        own |= {path.stem for path in (ROOT / "examples").glob("*.py")}
        for one in set().union(*map(imported, codes)) - own:
            if has.isdisjoint({f"ros-{canonical(one)}", *map(canonical, owners.get(one, ()))}):
                missing[one] = page
    assert missing == {}


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> Places:
    """Return environments like those of the run tier and of the wheel, made of the packages that the tests have."""
    try:
        distribution("ros-rclpy")
    except PackageNotFoundError:
        pytest.skip("the environments are made of the ROS wheels")
    return Places(tmp_path_factory.mktemp("journeys"), is_offline=True, wheel=release(tmp_path_factory)[1])


@pytest.fixture(scope="module")
def prepared() -> set[tuple[str, str]]:
    return set()


@pytest.mark.ros
@pytest.mark.pipeline
@pytest.mark.parametrize("journey", CHEAP, ids=[one.name for one in CHEAP])
def test_each_cheap_journey_succeeds(journey: Journey, places: Places, prepared: set[tuple[str, str]]) -> None:
    place = places.environment(journey.environment)
    if (journey.page, journey.environment) not in prepared:
        prepared.add((journey.page, journey.environment))
        table.prepare(journey, place)
    fault, _ = table.travel(journey, place, is_cheap=True)
    assert fault == ""
