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
"""Build backend for pip: that of setuptools, with Numba where the kernels are not there as assembly."""

from __future__ import annotations

import sysconfig
from pathlib import Path

from setuptools.build_meta import *  # noqa: F403  # a backend is a module with these functions

HERE = Path(__file__).parent
ASSEMBLY = HERE.parent / "impact_rig" / "kernels" / "assembly"


def get_requires_for_build_wheel(config_settings: dict[str, str] | None = None) -> list[str]:  # noqa: ARG001  # pip's
    """Return the packages that translate the kernels; none where a release holds their assembly."""
    machine = sysconfig.get_platform().rpartition("-")[2]
    if any(ASSEMBLY.glob(f"{machine}-*.s")):
        return []
    pins = (line.partition(" ")[0] for line in (HERE / "kernels.txt").read_text(encoding="utf-8").splitlines())
    return ["attrs", "PyYAML", *(pin for pin in pins if "==" in pin)]


get_requires_for_build_editable = get_requires_for_build_wheel
