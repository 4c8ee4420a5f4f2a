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
"""Public names: each is documented, on its page and in its docstring, and is loaded when it is first used."""

from __future__ import annotations

import builtins
import inspect
import pkgutil
import re
from pathlib import Path

import impact_rig

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "api.md"


def test_the_page_of_the_api_lists_exactly_the_public_names() -> None:
    shown = re.findall(r"^::: impact_rig\.(\w+)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(shown) == impact_rig.__all__


def test_every_public_name_exists_and_has_a_docstring() -> None:
    for name in impact_rig.__all__:
        found = getattr(impact_rig, name)
        assert (found.__doc__ or "").strip(), name
        assert found.__module__.startswith("impact_rig"), name


def test_the_first_example_is_the_rig_of_the_paper_at_resonance() -> None:
    assert str(impact_rig.simulate(20.0)).startswith("DT 63.57 ± 0.32 (2u) at 9.1 Hz")


def documented() -> list[tuple[str, object]]:
    """Return each public name, and each public function or property of a public class, with its full name."""
    found: list[tuple[str, object]] = []
    for name in impact_rig.__all__:
        one = getattr(impact_rig, name)
        found.append((name, one))
        if isinstance(one, type) and not issubclass(one, Exception):
            members = {key: inspect.getattr_static(one, key) for key in dir(one) if not key.startswith("_")}
            found += [
                (f"{name}.{key}", getattr(one, key) if isinstance(value, classmethod) else value)
                for key, value in members.items()
                if isinstance(value, property | classmethod) or inspect.isfunction(value)
            ]
    return found


def text_of(one: object) -> str:
    return inspect.getdoc(one) or ""


def test_every_parameter_is_described() -> None:
    """A reader of `help` need not open the source to learn what to pass."""
    missing = [
        f"{name}: {parameter}"
        for name, one in documented()
        if callable(one) and not name.endswith("Error")
        for parameter in inspect.signature(one).parameters
        if parameter != "self" and not re.search(rf"^    {parameter}: ", text_of(one), re.MULTILINE)
    ]
    assert not missing


def test_every_docstring_refers_to_related_names() -> None:
    alone = [name for name in impact_rig.__all__ if "\nSee Also:\n" not in text_of(getattr(impact_rig, name))]
    assert [name for name in alone if not name.endswith("Error")] == []


def test_every_name_in_a_docstring_can_be_looked_up() -> None:
    """Classes and errors are public, builtin or given by their full name, and pages exist."""
    known, unknown = {*impact_rig.__all__, *vars(builtins)}, []
    for name, one in documented():
        text = text_of(one)
        classes = set(re.findall(r"`([A-Z][a-z]+[A-Z]\w*)\b", text)) - known
        pages = {page for page in re.findall(r"\bdocs/[\w/-]+\.md", text) if not (PAGE.parents[2] / page).exists()}
        raised = re.search(r"^Raises:\n((?:    .*\n?|\n)+)", text, re.MULTILINE)
        errors = set(re.findall(r"^    ([\w.]+): ", raised[1] if raised else "", re.MULTILINE))
        errors = {error for error in errors - known if not is_in_python(error)}
        unknown += [f"{name}: {what}" for what in (*classes, *pages, *errors)]
    assert not unknown


def is_in_python(name: str) -> bool:
    """Return whether a name with dots can be imported."""
    return "." in name and isinstance(pkgutil.resolve_name(name), type)


def test_help_on_the_package_describes_each_name() -> None:
    for name in impact_rig.__all__:
        assert re.search(rf"^    (?:\w+, )?{name}(?:, \w+)?  +\w", impact_rig.__doc__ or "", re.MULTILINE), name
