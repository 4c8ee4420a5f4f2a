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
"""Services of the machine for programs: signals, limits for untrusted files, safe files, locks, optional libraries."""

from __future__ import annotations

import importlib
from collections.abc import Callable

from impact_rig.system.extras import load_ros


def lazily(package: str, needs_ros: str = "", **homes: str) -> Callable[[str], object]:
    """Return the `__getattr__` of a package whose public names are defined in other modules.

    Args:
        package: name of the package.
        needs_ros: its module that needs ROS 2; without ROS 2, names of this module raise an `ImpactRigError`.
        homes: module of each name, within the package or with its full name.
    """

    def find(name: str) -> object:
        """Load a public name at its first use."""
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home = homes[name]
        module = home if "." in home else f"{package}.{home}"
        found = load_ros(module, f"{package}.{name}") if home == needs_ros else importlib.import_module(module)
        return getattr(found, name)

    find.__name__ = "__getattr__"  # as `help` shows it
    return find
