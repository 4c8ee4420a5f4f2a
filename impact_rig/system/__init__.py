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
    """Return a `__getattr__` function for a package, which imports a module when one of its public names is first used.

    Args:
        package: name of the package.
        needs_ros: module among the values of `homes` that needs ROS 2. Without ROS 2, its names raise an
            `ImpactRigError`.
        homes: for each public name, the module that defines it: relative to the package, or by its full name.
    """

    def find(name: str) -> object:
        """Return the object with a public name of the package, from the module that defines it.

        Raises:
            AttributeError: the package has no such public name.
            ImpactRigError: the name needs ROS 2, which is not installed.
        """
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home = homes[name]
        module = home if "." in home else f"{package}.{home}"
        found = load_ros(module, f"{package}.{name}") if home == needs_ros else importlib.import_module(module)
        return getattr(found, name)

    find.__name__ = "__getattr__"  # as `help` shows it
    return find
