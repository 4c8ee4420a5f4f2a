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
"""Configuration files with mistakes: they are rejected with file, key, value and range, or the rig runs.

By default, a short sample is tested; IMPACT_RIG_HOSTILE=2000 tests this number of files.
"""

from __future__ import annotations

import contextlib
import io
import os
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from impact_rig.cli.main import EXIT_ERROR, main
from impact_rig.errors import ConfigError
from impact_rig.instruments.section import CHANNELS
from impact_rig.rig import Rig, config
from impact_rig.rig.config import RigConfig
from impact_rig.system import budget
from impact_rig.system.files import config_dir

CASES = int(os.environ.get("IMPACT_RIG_HOSTILE", "120"))
pytestmark = pytest.mark.timeout(120 + CASES)
FIELDS = {name: (about, default) for name, about, default in config.fields()}
NOMINAL = yaml.safe_load((config_dir() / "nominal.yaml").read_text(encoding="utf-8"))["/**"]["ros__parameters"]

SLIPS = {"m": 1e3, "kg": 1e3, "Pa": 1e-9, "kg/m^3": 1e-3, "H": 1e3}
"""Factor on a value that a user writes in millimetres, grams, GPa, g/cm³ or mH."""


def slipped(name: str) -> object:
    """Return the default in a unit that is often used by mistake."""
    return FIELDS[name][1] * SLIPS[FIELDS[name][0].unit]


@pytest.mark.parametrize("name", [name for name, (about, value) in FIELDS.items() if about.unit in SLIPS and value])
def test_a_value_in_a_wrong_unit_is_rejected(name: str) -> None:
    """For example, a gap of 6 instead of 0.006, or a mass of 130 instead of 0.13."""
    with pytest.raises(ConfigError, match=f"{name.rsplit('.', maxsplit=1)[-1]} must be"):
        config.from_flat(RigConfig(), {name: slipped(name)})


_scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=6),
    st.dates(),
    st.lists(st.integers(), max_size=2),
)
_mistakes = st.one_of(
    st.tuples(st.just("value"), st.sampled_from(list(FIELDS)), _scalars),
    st.tuples(
        st.just("scale"), st.sampled_from(list(FIELDS)), st.sampled_from([1e-9, 1e-6, 1e-3, -1, 0, 1e3, 1e6, 1e9])
    ),
    st.tuples(st.just("missing"), st.sampled_from(list(FIELDS)), st.none()),
    st.tuples(st.just("unknown"), st.sampled_from(list(FIELDS)), st.text("abcdefgh_", min_size=1, max_size=5)),
    st.tuples(st.just("flat"), st.sampled_from(list(NOMINAL)), _scalars),
)


def with_mistake(tree: dict, kind: str, name: str, what: object) -> None:
    """Make one mistake in the nested values."""
    *path, key = name.split(".")
    for part in path:
        tree = tree.get(part) if isinstance(tree, dict) else None
        if not isinstance(tree, dict):
            return  # an earlier mistake took this branch away
    if kind == "missing":
        tree.pop(key, None)
    elif kind == "unknown":
        tree[f"{key}{what}"] = tree.pop(key, 1.0)
    elif kind == "scale":
        old = tree.get(key)
        tree[key] = old * what if isinstance(old, float) else what
    else:
        tree[key] = what


def copy(tree: object) -> object:
    return {key: copy(value) for key, value in tree.items()} if isinstance(tree, dict) else tree


@settings(max_examples=max(1, CASES // 3))
@given(st.lists(_mistakes, min_size=1, max_size=3), st.booleans())
@pytest.mark.repeats
def test_a_file_with_mistakes_is_rejected_by_name_or_runs(tmp_path_factory, mistakes, wrapped) -> None:
    tree = copy(NOMINAL)
    for kind, name, what in mistakes:
        with_mistake(tree, kind, name, what)
    path = tmp_path_factory.getbasetemp() / "mistaken.yaml"
    path.write_text(yaml.safe_dump({"/**": {"ros__parameters": tree}} if wrapped else tree), encoding="utf-8")
    with contextlib.redirect_stderr(io.StringIO()) as errors, contextlib.redirect_stdout(io.StringIO()):
        code = main(["check", str(path)])
    if code:
        said = errors.getvalue()
        assert code == EXIT_ERROR
        assert said.startswith("impact-rig check: ")
        assert said.count("\n") == 1, "one line"
        assert str(path) in said
        return
    _runs(path)


def _runs(path: Path) -> None:
    """Check that a configuration that `check` calls valid makes a rig with finite signals."""
    rig = Rig(config.load_config(path))
    for block in rig.advance(20_000_000):
        for name in CHANNELS:
            assert np.isfinite(block.scan.rows[name]).all()


@pytest.mark.parametrize("text", ["a: 1\na: 2\n", "b: {a: 1, a: 1}", "- {'x': 1, x: 2}"])
def test_a_duplicate_key_is_rejected(text: str) -> None:
    """Otherwise, the later value would silently replace the first."""
    with pytest.raises(budget.PlainYamlError, match=r"duplicate key .* in line"):
        budget.load_yaml(text, 100)
    assert budget.load_yaml("1: a\n'1': b\n", 100) == {1: "a", "1": "b"}
