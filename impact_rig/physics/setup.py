# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
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
