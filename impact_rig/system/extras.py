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
"""Optional libraries: those of an extra of the package, and ROS 2."""

from __future__ import annotations

import importlib
from typing import Any

from impact_rig.errors import ImpactRigError


def load(module: str, purpose: str, extra: str) -> Any:  # a module, whose names a type checker cannot know
    """Import an optional library, or a module of this project that needs one, and return the module.

    Args:
        module: full name of the module.
        purpose: feature that needs the library, with which the message begins.
        extra: name of the extra in `setup.py` that installs the library, such as `tables`.

    Raises:
        ImpactRigError: a library is not installed; the message has the command that installs it.
    """
    return _load(module, f"{purpose} needs {{library}}, which is not installed: pip install 'impact_rig[{extra}]'")


def load_ros(module: str, purpose: str) -> Any:
    """Import a module of this project that needs ROS 2, and return the module.

    Args:
        module: full name of the module.
        purpose: feature that needs ROS 2, with which the message begins.

    Raises:
        ImpactRigError: ROS 2, or another library that the module imports, is not installed; the message has the
            commands that provide ROS 2.
    """
    remedy = "pip install 'impact_rig[wheels]', or, where apt installed it, source /opt/ros/jazzy/setup.bash"
    return _load(module, f"{purpose} needs ROS 2 Jazzy ({{error}}): {remedy}")


def _load(module: str, message: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        library = (error.name or module).partition(".")[0]
        if library.startswith("impact_rig"):  # a mistake in this project
            raise
        raise ImpactRigError(message.format(library=library, error=error)) from error
