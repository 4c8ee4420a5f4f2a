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
"""Generated files agree with the code."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from tools.generate import COMMAND, ROOT, TABLES, generated

FILES = generated()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_each_generated_file_equals_the_output_of_the_code(path):
    assert path.read_text(encoding="utf-8") == FILES[path], f"run `{COMMAND}` and read what has changed"


def test_every_generated_table_is_on_one_page():
    pages = "".join(text for path, text in FILES.items() if path.suffix == ".md")
    for name in TABLES:
        assert pages.count(f"<!-- generated: {name} -->") == 1, name
    assert pages.count("<!-- generated: ") == pages.count("<!-- end -->") == len(TABLES)
    assert ROOT.joinpath("config", "nominal.yaml") in FILES
