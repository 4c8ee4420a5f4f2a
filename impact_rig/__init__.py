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
"""impact_rig: the test rig of an impact damper as virtual hardware for ROS 2.

`impact_rig.simulate` is the first look, without ROS. Importing this package imports neither rclpy nor numpy; see
`docs/` for the interface and the physics.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from impact_rig.simulation import Record, simulate

__all__ = ["Record", "simulate"]
__version__ = "0.1.0"


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from impact_rig import simulation  # noqa: PLC0415  # numpy and the rig: only when asked for

    return getattr(simulation, name)
