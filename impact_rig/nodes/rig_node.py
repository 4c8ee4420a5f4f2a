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
"""Rig as a lifecycle node: its parameters, transitions and diagnostics; `Session` runs the rig."""

from __future__ import annotations

import functools
import time
from typing import Any  # rclpy messages

import attrs

from impact_rig import graph, states
from impact_rig.nodes.managed import Level, ManagedNode, NodeState
from impact_rig.nodes.process import DISCOVERY_S
from impact_rig.nodes.rig_state import RigState
from impact_rig.nodes.session import Session
from impact_rig.nodes.standard_services import StandardServices
from impact_rig.rig import Rig
from impact_rig.rig.config import TREE, RigConfig


class RigNode(ManagedNode[RigConfig]):
    """Lifecycle node whose activation starts the simulated rig, and whose deactivation ends it.

    Args:
        discovery_s: time [s] after the creation of the node before which `configure` does not return. In this time, the
            node discovers other rigs on its topics. The wait is left out if a lock file would show any other rig.
        kwargs: passed to `ManagedNode`.
    """

    COMPONENT = "simulation"
    STATES = states.RigWord
    MAKES_TIME = True

    def __init__(self, discovery_s: float = 0.0, **kwargs: Any) -> None:
        self._discovered_at = time.monotonic() + discovery_s
        super().__init__("rig", TREE, **kwargs)
        self.frame_prefix = self.settings.output.frame_prefix
        self._session = Session(self)
        self._state = RigState(self._session)
        self._standard = StandardServices(self._session)

    def complete(self, settings: RigConfig) -> RigConfig:
        """Return the settings with `output.frame_prefix` made from the node's namespace, unless it is set already."""
        prefix = graph.frame_prefix(self.get_namespace(), settings.output.frame_prefix)
        return attrs.evolve(settings, output=attrs.evolve(settings.output, frame_prefix=prefix))

    def autostarts(self) -> bool:
        """Return whether the node configures and activates itself at start: the setting `output.autostart`."""
        return self.settings.output.autostart

    def configure(self) -> None:
        """Check that the rig can be built, load compiled code, create the publishers, and wait until discovery is over.

        It does not wait if a lock file would show any other rig of the namespace. Another rig is no error here: once
        active, the node waits until that rig has ended.

        Raises:
            ConfigError: the rig cannot be built; the transition fails with this message.
        """
        Rig(self.settings)  # its trial simulation loads the compiled code
        self._session.configure()
        # wait here, so that a client that finds the node active may command it at once
        if not self._session.lock.decides:
            time.sleep(max(0.0, self._discovered_at - time.monotonic()))

    def activate(self) -> None:
        """Start the rig as soon as no other rig is in this namespace and, in real time, its peers have subscribed.

        The wait for peers ends after `time.start_wait_s`. This method does not wait: if the rig cannot start at once, a
        timer starts it later.
        """
        self._session.activate()

    def deactivate(self) -> None:
        """End the rig; blocks that are simulated but not yet published are dropped."""
        self._session.deactivate()

    def settings_changed(self, settings: RigConfig, changes: dict[str, Any]) -> None:
        """Apply new, validated settings to the running rig, or store them for the next rig if none has started.

        Raises:
            ImpactRigError: the rig rejects the settings; nothing is changed.
        """
        self._session.change(settings, changes)

    def rig_time_ns(self) -> int | None:
        """Return the stamp of the next block [ns of rig time], for diagnostics.

        Without a started rig, the result is the system time in real time and None in other time modes.
        """
        if self._session.rig is not None:
            return self._session.rig.next_block_ns
        return time.time_ns() if self._session.is_realtime else None

    def doing(self) -> NodeState:
        """Return the state of the rig, with its reason, for diagnostics."""
        return self._state.word()

    def health(self) -> tuple[Level, str]:
        """Return level and message of the rig's diagnostics; also log what has changed since the last call."""
        self._state.log_changes()
        return self._state.health()

    def figures(self) -> dict[str, object]:
        """Return values for diagnostics: time mode and, once started, time, lateness, readers, drive, energy, scans.

        Which keys there are depends on the time mode, the drive, the channels and the readers.
        """
        return self._state.figures()


PROGRAM = functools.partial(RigNode, discovery_s=DISCOVERY_S)
"""Factory of the node for the program `rig_node`."""
