# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A rig behind topics as a controller's hardware: `shaker/waveform` out, `shaker/stream` and `daq/scan` in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from impact_rig import codec, topics
from impact_rig.blocks import WAVEFORM, Table
from impact_rig.client.client import Client
from impact_rig.errors import ImpactRigError
from impact_rig.operate.hardware import Hardware, Wanted
from impact_rig.simtime import NS_PER_S, stamp_ns


class OverTopics:
    """A wire to a rig behind topics.

    It acknowledges scans in the client's name: in `freewheel` and `stepped` the client is among `time.peers`.

    Args:
        client: connected to an active rig whose drive is a stream.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        found = client.get_parameters("rig", ["drive.stream_rate_hz", "daq.rate_hz"])
        self.rate_hz, self.scan_rate_hz = (int(value) for value in found.values())
        self._scans = client.collect(topics.SCAN.name, acknowledge=True)
        self._stream = client.collect(topics.STREAM.name)
        client.wait_until(self._stream.last, f"{topics.STREAM.name} (drive.waveform: stream)")
        self._sent_to = 0

    def feed(self, first: int, samples: NDArray[np.float64]) -> None:
        """Publish a block."""
        rows = np.zeros(len(samples), WAVEFORM)
        rows["value"] = samples
        self._client.publish(
            topics.WAVEFORM, codec.encode(Table(stamp_ns(first, self.rate_hz, self._start_ns()), rows)), listener="rig"
        )
        self._sent_to = first + len(samples)

    def wanted(self) -> Wanted:
        """Return what the rig said last; what was sent since counts as buffered."""
        table = self._stream.last()
        assert table is not None
        row = table.rows[0]
        sample = int(row["wanted"])
        return Wanted(sample, max(int(row["buffered"]), self._sent_to - sample), int(row["capacity"]))

    def turn(self, timeout_s: float) -> tuple[int, NDArray[np.void]] | None:
        """Spin until a block of scans comes."""
        try:
            self._client.wait_until(lambda: len(self._scans), "a block of scans", timeout_s)
        except ImpactRigError:
            return None
        table = self._scans.tables()[0]
        del self._scans.received[0]
        if len(self._stream.received) > 1:  # the newest is enough
            del self._stream.received[:-1]
        since = table.stamp_ns - self._start_ns()
        return (2 * since * self.scan_rate_hz + NS_PER_S) // (2 * NS_PER_S), table.rows

    def _start_ns(self) -> int:
        table = self._stream.received[-1].table
        assert table is not None
        return table.stamp_ns - stamp_ns(int(table.rows["wanted"][0]), self.rate_hz)


def over_topics(client: Client) -> Hardware:
    """Return output and acquisition of a rig behind topics."""
    return Hardware(OverTopics(client))
