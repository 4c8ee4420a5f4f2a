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
"""What README and docs show works in the environment that each page names; `make journeys` runs all of it."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, distribution

import pytest

pytest.importorskip("markdown_it", reason="comes with rich, except with Ubuntu's")

from tools import journeys as table
from tools.journeys import ENVIRONMENTS, JAZZY, ROOT, Journey, Places

CHEAP = [one for one in table.journeys() if one.cheap]


def test_every_command_has_a_journey_in_the_environment_of_its_page() -> None:
    assert table.faults() == []


def test_a_journey_is_run_or_says_why_not() -> None:
    for one in table.journeys():
        assert one.environment in ENVIRONMENTS, one.name
        assert one.not_run or one.environment != JAZZY, one.name
        assert not (one.cheap and one.not_run), one.name
        assert not (one.cheap and "make " in (one.instead or one.run)), f"{one.name}: it would install"
        assert one.not_run or not one.instead or one.instead != one.run, one.name
    assert {"clone", "wheel[import]"} <= {one.environment for one in CHEAP}


def test_a_new_command_without_a_journey_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    from tools.check_docs import Page

    text = (ROOT / "docs" / "instruments.md").read_text(encoding="utf-8") + "\n```sh\nimpact-rig check new.yaml\n```\n"
    monkeypatch.setattr(table, "pages", lambda: {"docs/instruments.md": Page.parse("docs/instruments.md", text)})
    assert table.faults() == ["docs/instruments.md: impact-rig check new.yaml: it has no journey in journeys.yaml"]


def test_what_is_run_instead_of_a_command_exists() -> None:
    from tools.doc_commands import command_faults, commands

    said = {text for one in table.journeys() for text in (one.instead, *one.before)}
    assert [fault for text in said for words in commands(text) for fault in command_faults(words, whole=True)] == []


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> Places:
    """What the run tier has, what the wheel brings: assembled from what the tests have installed."""
    try:
        distribution("ros-rclpy")
    except PackageNotFoundError:
        pytest.skip("the environments are made of the ROS wheels")
    return Places(tmp_path_factory.mktemp("journeys"), is_offline=True)


@pytest.fixture(scope="module")
def prepared() -> set[tuple[str, str]]:
    return set()


@pytest.mark.ros
@pytest.mark.pipeline
@pytest.mark.parametrize("journey", CHEAP, ids=[one.name for one in CHEAP])
def test_a_cheap_journey(journey: Journey, places: Places, prepared: set[tuple[str, str]]) -> None:
    place = places.environment(journey.environment)
    if (journey.page, journey.environment) not in prepared:
        prepared.add((journey.page, journey.environment))
        table.prepare(journey, place)
    fault, _ = table.travel(journey, place)
    assert fault == ""
