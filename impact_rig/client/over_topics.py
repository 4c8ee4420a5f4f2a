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
"""A rig behind topics as the hardware of a controller, or driven and followed, while a recorder records it.

Of a controller the running nodes are the hardware: `shaker/waveform` out, `shaker/stream` and `daq/scan` in.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from impact_rig import codec, topics
from impact_rig.blocks import WAVEFORM, Table
from impact_rig.client.client import Client, WaitTimeoutError, subscribers
from impact_rig.client.hardware import Hardware, Wanted
from impact_rig.client.processes import ParameterValue, Processes, domain_of_environment, isolated_domain
from impact_rig.errors import CommandError, ConfigError, ImpactRigError
from impact_rig.nodes.process import DISCOVERY_S
from impact_rig.rig import InputKind
from impact_rig.rig.config import RigConfig, differences
from impact_rig.simtime import NS_PER_S, stamp_ns

CONTROLLER = "controller"  # of the client's node: in `freewheel` and `stepped` it is among `time.peers`
REALTIME_LEAD_S = 0.2
SCANS_TIMEOUT_S = 30.0  # wall time in which a rig that is followed must have given scans
_STOPS = (InputKind.TRIP, InputKind.STOP)


class OverTopics:
    """A wire to a rig behind topics.

    It acknowledges scans in the client's name: in `freewheel` and `stepped` the client is among `time.peers`.

    Args:
        client: connected to an active rig whose drive is a stream.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        client.publisher(topics.WAVEFORM)  # is found while the rest is waited for: what a recorder misses is lost to it
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
        with contextlib.suppress(WaitTimeoutError):  # one that has died, or a peer that is not there
            client.wait_until(self._finds_readers, "everybody who reads the rig", DISCOVERY_S)

    def _finds_readers(self) -> bool:
        """Whether all are found that the rig says it is read by: a recorder that is not misses the first samples."""
        figures = self._client.figures("rig")
        names = {key.removeprefix("behind.") for key in figures if key.startswith("behind.")}
        return bool(figures) and names <= subscribers(self._client.node, topics.SCAN.name)

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
            GoneError: a process ended.
        """
        try:
            self._client.wait_until(lambda: len(self._scans), "a block of scans", timeout_s)
        except WaitTimeoutError:
            self._refuse_if_stopped()
            return None
        table = self._scans.tables()[0]
        del self._scans.received[0]
        if len(self._stream.received) > 1:  # the newest is enough
            del self._stream.received[:-1]
        since = table.stamp_ns - self._start_ns()
        return (2 * since * self.scan_rate_hz + NS_PER_S) // (2 * NS_PER_S), table.rows

    def _refuse_if_stopped(self) -> None:
        for entry in self._journal.entries(self._before):
            if entry.kind in _STOPS:
                raise CommandError(f"the rig stopped: {entry.kind.value} {entry.name}".rstrip())

    def _start_ns(self) -> int:
        table = self._stream.received[-1].table
        assert table is not None
        return table.stamp_ns - stamp_ns(int(table.rows["wanted"][0]), self.rate_hz)


def over_topics(client: Client) -> Hardware:
    """Return output and acquisition of a rig behind topics."""
    return Hardware(OverTopics(client))


@contextlib.contextmanager
def recorded(directory: Path, config: RigConfig, namespace: str | None = None) -> Iterator[OverTopics]:
    """Give a wire to a rig behind topics while a recorder records it; see `recording`."""
    with recording(directory, config, namespace, waveform="stream") as client:
        yield OverTopics(client)


class MeasuredOverTopics:
    """A driven and recorded rig behind topics, followed block by block.

    Args:
        client: connected to an active rig; where the rig waits for its peers, the client is one of them.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self._scans = client.collect(topics.SCAN.name, acknowledge=True)
        self._journal = client.collect(topics.JOURNAL.name)
        self._before = len(self._journal)

    def command(self, frequency_hz: float | None, current_a: float | None) -> None:
        """Command frequency and current, each if it is a number, and wait until they are applied."""
        if frequency_hz is not None or current_a is not None:
            self._client.command(frequency_hz, current_a)

    def advance(self) -> int:
        """Wait for the next scans and return the rig time that they reach [ns].

        Raises:
            CommandError: the rig has stopped.
            ImpactRigError: no scans arrived.
        """
        for entry in self._journal.entries(self._before):
            if entry.kind in _STOPS:
                raise CommandError(f"the rig stopped: {entry.kind.value} {entry.name}".rstrip())
        what = "a block of scans"
        self._client.wait_until(lambda: len(self._scans), what, SCANS_TIMEOUT_S, self._client.given(what))
        newest = self._scans.last()
        assert newest is not None
        self._scans.clear()
        return newest.stamp_ns


@contextlib.contextmanager
def recording(
    directory: Path,
    config: RigConfig,
    namespace: str | None = None,
    *,
    waveform: str = "",
    analysis: Mapping[str, ParameterValue] | None = None,
) -> Iterator[Client]:
    """Give a client of a rig behind topics while a recorder records it.

    Args:
        directory: of the run.
        config: of the rig that is started, as fast as recorder, client and analysis follow.
        namespace: of a rig that runs already, in this environment's domain, and is driven instead; None: there is none.
        waveform: that a rig that runs already must have; empty: any.
        analysis: parameters of an analysis that is started with the rig; None: there is none.
    """
    with contextlib.ExitStack() as stack:
        running = namespace is not None
        domain_id = domain_of_environment() if running else stack.enter_context(isolated_domain())
        logs = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="impact_rig_stream_")))
        processes = stack.enter_context(Processes(domain_id, logs, namespace or ""))
        recorder = "stream_recorder" if running else "recorder"
        values = {"directory": str(directory.parent), "name": directory.name}
        if not running:
            peers = [CONTROLLER, recorder, *(["analysis"] if analysis is not None else [])]
            processes.start("rig", {**differences(config), "time.mode": "freewheel", "time.peers": peers})
            if analysis is not None:
                processes.start("analysis", analysis)
        client = stack.enter_context(Client(domain_id, namespace or "", processes=processes, name=CONTROLLER))
        if running:
            client.wait_active("rig")
            if waveform and client.get_parameters("rig", ["drive.waveform"])["drive.waveform"] != waveform:
                raise ConfigError(f"the rig that runs must have drive.waveform: {waveform}")
        processes.start("recorder", values, name=recorder)
        client.wait_active("rig", recorder)
        client.wait_until(lambda: client.status(recorder).message == "recording", "the recorder")
        try:
            yield client
        finally:
            with contextlib.suppress(ImpactRigError):
                client.trigger(f"{recorder}/stop")
