# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A rig behind topics as a controller's hardware: `shaker/waveform` out, `shaker/stream` and `daq/scan` in."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from impact_rig import codec, topics
from impact_rig.blocks import WAVEFORM, Table
from impact_rig.client.client import Client
from impact_rig.client.domain import isolated_domain
from impact_rig.client.processes import Processes
from impact_rig.errors import CommandError, ConfigError, ImpactRigError
from impact_rig.operate.hardware import Hardware, Wanted
from impact_rig.rig import Kind
from impact_rig.rig.config import RigConfig, to_flat
from impact_rig.simtime import NS_PER_S, stamp_ns

NAME = "controller"
"""Of the client's node: in `freewheel` and `stepped` it is among `time.peers`."""
REALTIME_LEAD_S = 0.2
_STOPS = tuple(kind.value.encode() for kind in (Kind.TRIP, Kind.STOP))


class OverTopics:
    """A wire to a rig behind topics.

    It acknowledges scans in the client's name: in `freewheel` and `stepped` the client is among `time.peers`.

    Args:
        client: connected to an active rig whose drive is a stream.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        found = client.get_parameters("rig", ["drive.stream_rate_hz", "daq.rate_hz", "time.mode"])
        self.rate_hz, self.scan_rate_hz = int(found["drive.stream_rate_hz"]), int(found["daq.rate_hz"])
        self.lead_s = REALTIME_LEAD_S if found["time.mode"] == "realtime" else 0.0
        self._info = client.collect(topics.INFO.name)
        self._journal = client.collect(topics.JOURNAL.name)
        self._scans = client.collect(topics.SCAN.name, acknowledge=True)
        self._stream = client.collect(topics.STREAM.name)
        client.wait_until(self._stream.last, f"{topics.STREAM.name} (drive.waveform: stream)")
        client.wait_until(self._info.last, topics.INFO.name)
        self._sent_to, self._before = 0, len(self._journal)

    def info(self) -> NDArray[np.void]:
        """Return the calibration as last published."""
        table = self._info.last()
        assert table is not None
        return table.rows

    def feed(self, first: int, samples: NDArray[np.float64]) -> None:
        """Publish a block.

        Raises:
            CommandError: the rig has stopped.
        """
        self._refuse_if_stopped()
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
        """Spin until a block of scans comes.

        Raises:
            CommandError: the rig has stopped.
        """
        try:
            self._client.wait_until(lambda: len(self._scans), "a block of scans", timeout_s)
        except ImpactRigError:
            self._refuse_if_stopped()
            return None
        table = self._scans.tables()[0]
        del self._scans.received[0]
        if len(self._stream.received) > 1:  # the newest is enough
            del self._stream.received[:-1]
        since = table.stamp_ns - self._start_ns()
        return (2 * since * self.scan_rate_hz + NS_PER_S) // (2 * NS_PER_S), table.rows

    def _refuse_if_stopped(self) -> None:
        for table in self._journal.tables(self._before):
            for row in table.rows[np.isin(table.rows["kind"], _STOPS)]:
                raise CommandError(f"the rig stopped: {row['kind'].decode()} {row['key'].decode()}".rstrip())

    def _start_ns(self) -> int:
        table = self._stream.received[-1].table
        assert table is not None
        return table.stamp_ns - stamp_ns(int(table.rows["wanted"][0]), self.rate_hz)


def over_topics(client: Client) -> Hardware:
    """Return output and acquisition of a rig behind topics."""
    return Hardware(OverTopics(client))


@contextlib.contextmanager
def recorded(directory: Path, config: RigConfig, namespace: str | None = None) -> Iterator[OverTopics]:
    """Give a wire to a rig behind topics while a recorder records it.

    Args:
        directory: of the run.
        config: of the rig that is started, as fast as recorder and client follow.
        namespace: of a rig that runs already, in this environment's domain, and is driven instead; None: there is none.
    """
    with contextlib.ExitStack() as stack:
        running = namespace is not None
        domain_id = int(os.environ.get("ROS_DOMAIN_ID", "0")) if running else stack.enter_context(isolated_domain())
        logs = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="impact_rig_stream_")))
        processes = stack.enter_context(Processes(domain_id, logs, namespace or ""))
        recorder = "stream_recorder" if running else "recorder"
        values = {"directory": str(directory.parent), "name": directory.name}
        if not running:
            default = to_flat(RigConfig())
            changed = {name: value for name, value in to_flat(config).items() if value != default[name]}
            processes.start("rig", changed | {"time.mode": "freewheel", "time.peers": [NAME, recorder]})
        client = stack.enter_context(Client(domain_id, namespace or "", processes=processes, name=NAME))
        if running:
            client.wait_active("rig")
            if client.get_parameters("rig", ["drive.waveform"])["drive.waveform"] != "stream":
                raise ConfigError("the rig that runs must have drive.waveform: stream")
        processes.start("recorder", values, name=recorder)
        client.wait_active("rig", recorder)
        client.wait_until(lambda: client.status(recorder).message == "recording", "the recorder")
        try:
            yield OverTopics(client)
        finally:
            with contextlib.suppress(ImpactRigError):
                client.trigger(f"{recorder}/stop")
