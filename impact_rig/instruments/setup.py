# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What the instruments read of a rig's configuration."""

from __future__ import annotations

from typing import Protocol

from impact_rig.config.mechanics import Shaker, Structure
from impact_rig.config.operation import Daq
from impact_rig.instruments.section import Instruments


class Setup(Protocol):
    """Some sections of a configuration; `impact_rig.rig.config.RigConfig` has them."""

    @property
    def daq(self) -> Daq:
        """Scan clock and seed."""

    @property
    def instruments(self) -> Instruments:
        """The instruments themselves."""

    @property
    def shaker(self) -> Shaker:
        """How fast things move at most."""

    @property
    def structure(self) -> Structure:
        """What an impact makes jump."""
