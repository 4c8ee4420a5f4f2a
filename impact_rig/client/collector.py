# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What arrived on one topic, with what DDS knows about each message; tables as numpy arrays."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any  # message classes have no common base

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import codec
from impact_rig.blocks import Table
from impact_rig.errors import CodecError
from impact_rig.topics import Topic


@attrs.frozen(eq=False)
class Received:
    """One message.

    Attributes:
        sequence: DDS publication sequence number: contiguous per publisher.
        received_system_ns: system clock at the callback [ns], comparable with stamps in realtime.
    """

    data: Any
    sequence: int
    received_system_ns: int
    table: Table | None = None


class Collector:
    """Keeps every message of one topic.

    A message that is no table of its topic is refused: counted, and not kept.
    """

    def __init__(self, topic: Topic, on_message: Callable[[Received], None] | None = None) -> None:
        self.topic = topic
        self.received: list[Received] = []
        self.refused = 0
        """Messages that were no tables of the topic."""
        self.last_refused = ""
        """Why the last of them was none."""
        self._on_message = [on_message] if on_message is not None else []

    def __len__(self) -> int:
        return len(self.received)

    def take(self, data: Any, info: dict[str, Any]) -> None:
        """Keep one message; the subscription's callback."""
        table = None
        if self.topic.columns is not None:
            try:
                table = codec.decode(data, self.topic)
            except CodecError as error:
                self.refused, self.last_refused = self.refused + 1, str(error)
                return
        message = Received(data, int(info["publication_sequence_number"]), time.time_ns(), table)
        self.received.append(message)
        for on_message in self._on_message:
            on_message(message)

    def then(self, on_message: Callable[[Received], None]) -> None:
        """Call this as well after each message that is kept from now on."""
        self._on_message.append(on_message)

    @property
    def messages(self) -> list[Any]:
        """The messages, or the CDR bytes of tables."""
        return [message.data for message in self.received]

    def tables(self, since: int = 0) -> list[Table]:
        """Return the decoded tables, without the first `since`."""
        return [message.table or codec.decode(message.data) for message in self.received[since:]]

    def last(self) -> Table | None:
        """Return the newest table, decoding nothing else; None if there is none."""
        found = self.tables(-1)
        return found[0] if found else None

    def rows(self) -> NDArray[np.void]:
        """Return the rows of all tables, one after the other; shape (n,)."""
        parts = [table.rows for table in self.tables()]
        assert parts or self.topic.columns is not None, f"{self.topic.name}: no tables have come, if it carries any"
        return np.concatenate(parts) if parts else np.empty(0, self.topic.columns)

    def lost(self) -> int:
        """Return how many messages are missing between the first and the last, by DDS sequence number."""
        numbers = [message.sequence for message in self.received]
        return int(numbers[-1] - numbers[0] + 1 - len(set(numbers))) if numbers else 0

    def clear(self) -> None:
        """Forget what arrived so far."""
        self.received.clear()
