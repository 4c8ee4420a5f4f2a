# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""What the mechanics read of a rig's configuration."""

from __future__ import annotations

from typing import Protocol

from impact_rig.config.mechanics import Barriers, Drive, Shaker, Sphere, Structure
from impact_rig.physics.contact import Contact


class Setup(Protocol):
    """Some sections of a configuration; `impact_rig.rig.config.RigConfig` has them."""

    @property
    def structure(self) -> Structure:
        """Columns and superior base."""

    @property
    def shaker(self) -> Shaker:
        """Table and coil."""

    @property
    def drive(self) -> Drive:
        """What drives it."""

    @property
    def sphere(self) -> Sphere:
        """The loose sphere."""

    @property
    def barriers(self) -> Barriers:
        """What it strikes."""

    @property
    def contact(self) -> Contact:
        """How it strikes."""
