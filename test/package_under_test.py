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
"""Choice of the package under test: the one that `colcon build` has installed, or the one in this source tree.

`colcon test` starts pytest in the source tree, so Python would import the package from there, without the built parts.
This module must not import the package.
"""

from __future__ import annotations

import os
import sys
from importlib.machinery import PathFinder
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = "impact_rig"
LIBRARY = "kernels/_library.abi3.so"
COLCON_OPTION = "--junit-prefix"
"""Option that `colcon test` passes to pytest."""


def find_installed() -> Path | None:
    """Return the folder of an installed package on the path that is not this source tree, or None."""
    elsewhere = [path for path in sys.path if Path(path or ".").resolve() != ROOT]
    spec = PathFinder.find_spec(PACKAGE, elsewhere)
    if spec is None or spec.origin is None:
        return None
    folder = Path(spec.origin).resolve().parent
    return None if folder.parent == ROOT else folder


def prefer_installed() -> None:
    """Import the installed package, here and in child processes, if the source tree was not built.

    Under `colcon test`, it is always preferred, because the source tree may contain an older library of `make`.
    """
    is_colcon = any(argument.startswith(COLCON_OPTION) for argument in sys.argv)
    if not is_colcon and (ROOT / PACKAGE / LIBRARY).exists():
        return
    if find_installed() is None:
        return
    sys.path[:] = [path for path in sys.path if Path(path or ".").resolve() != ROOT]
    # the pytest plugin of the package was imported before any conftest; what it imports later is the installed package
    for name in [name for name in sys.modules if name.partition(".")[0] == PACKAGE]:
        del sys.modules[name]
    os.environ["PYTHONSAFEPATH"] = "1"  # child processes do not search the current directory first
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (os.environ.get("PYTHONPATH"), str(ROOT))))
