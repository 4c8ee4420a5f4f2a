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
"""Live source of the page: a ROS client that receives the messages of a running rig and runs the requests of pages.

One event loop waits for messages of ROS, processes data when a picture is due, and runs actions. It never blocks while
an action waits for a node. Therefore STOP is sent even if a service hangs or an invalid message arrives.
"""

from __future__ import annotations

import asyncio
import functools
import re
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any  # values for JSON

from impact_rig import states, topics
from impact_rig.instruments.section import CHANNELS
from impact_rig.recording.rigs import namespace, prefix_of, prefixes
from impact_rig.topics import SCAN
from impact_rig_lab import state
from impact_rig_lab.record import LAST_NS, RigView
from impact_rig_lab.state import KNOBS, STANDING, Pace, Seen, Source, figure
from impact_rig_lab.theory import closed_form, lower_priority

if TYPE_CHECKING:
    from impact_rig.client.client import Client
    from impact_rig_lab.gateway import Gateway, OwnedProcesses

POLL_S = 0.02  # interval between two checks for data while a page is open
FAST_RIG_POLL_S = 0.5  # the same while rig time runs faster than real time
SUBSCRIBE_S, PAUSE_S = 0.1, 1.4
"""Durations of alternately receiving scans and receiving none [s], if the rig is too fast to draw all scans."""
TURN_S = 0.05  # longest wait of the loop while a page is open: a request of the page may be delayed by this time
IDLE_S = 0.2  # interval between two checks for data while no page is open
LATE_S = 5.0  # longest delay of a rig's first diagnostics after its other messages
STATE_S = 0.1  # interval between two state updates of the page
SLOW_S = 0.5  # the same while rig time runs faster than real time, and without an open page
SLOWEST_S = 1.0  # the same if the rig is too fast to follow


class LiveSource(Source):
    """Source of pages that show and control a running rig over ROS.

    Args:
        domain_id: ROS domain of the rig.
        namespace: namespace of the rig; None searches for one, and lets the page choose if there are several.
        own: nodes that the lab starts itself; None means that other programs run the rig.

    Attributes:
        directory: directory of the newest recording, or None.
    """

    def __init__(self, domain_id: int, namespace: str | None, own: OwnedProcesses | None = None) -> None:
        super().__init__("live", RigView())
        self.directory: Path | None = None  # directory of the recorder's last run
        self._domain_id, self._namespace, self._own = domain_id, namespace, own
        self._client: Client
        self._gateway: Gateway | None = None
        self._pace = Pace()
        self._instance = ""  # instance of the present rig
        self._listens = True  # whether the source receives scans now; it alternates if rig time is too fast
        self.snapshot.put(rig={"word": "starting", "text": "The lab is starting.", "name": namespace or ""})

    @property
    def now_s(self) -> float:
        """Time of the end of the newest scan [s since scan 0]; 0 before the first one."""
        return self.record.scope.end_s if self.record.scope is not None else 0.0

    def close(self) -> None:
        """End the thread of the source and its ROS client, and start no further nodes; running nodes continue."""
        super().close()
        if self._own is not None:
            self._own.close()

    # The loop

    def _run(self) -> None:
        try:
            if self._own is not None:
                for node in self._own.parameters:
                    self._own.start(node).result()
            lower_priority()
            asyncio.run(self._serve_rigs())
        except Exception as error:  # without its source the page must report the failure, not freeze
            self.snapshot.put(rig={"word": "dead", "text": f"The lab has failed: {error}", "name": ""})
            raise

    async def _serve_rigs(self) -> None:
        from impact_rig.client.client import Client  # noqa: PLC0415  # the page is served before the half second it takes
        from impact_rig_lab.gateway import Gateway  # noqa: PLC0415

        while not self.end.is_set():
            before, self.record = self.record, RigView()
            self.record.epoch = before.epoch + 1
            self._client = Client(self._domain_id, (self._namespace or "").strip("/"), name="lab", commands=False)
            self._gateway = Gateway(self._client, self.record, self._own) if self._namespace is not None else None
            try:
                await self._serve()
            finally:
                self.guard("state", self._tell)  # the last report of the recorder contains its directory
                if self._gateway is not None:
                    await self._gateway.close("cancelled, because the lab shows another rig now")
                self._client.close()

    async def _serve(self) -> None:
        """Serve one rig, or search for one, until the lab ends, a rig is found, or a page chooses another namespace."""
        look_at = state_at = slow_at = 0.0
        namespace = self._namespace
        while not self.end.is_set() and self._namespace == namespace:
            now = time.monotonic()
            if now >= look_at:
                self.guard("pictures", self._poll)
                look_at = now + self._until_next_look()
            if now >= state_at:
                self.guard("state", self._tell)
                state_at = now + self._until_next_word()
            if self._gateway is None and now >= slow_at:
                slow_at = now + SLOW_S
                self.guard("discovery", self._discover)
            # few messages take this path; spinning for longer than one message leaks 32 bytes a turn in rclpy
            wait_s = max(0.0, min(look_at, state_at) - time.monotonic())
            wait_s = min(wait_s, TURN_S) if self.watchers else wait_s
            self.guard("/diagnostics", functools.partial(self._client.executor.spin_once, timeout_sec=wait_s))
            self.guard("requests", self._take_requests)
            await asyncio.sleep(0)  # begins new actions at once, and lets every other one check its condition

    def _poll(self) -> None:
        """Process new messages of scans and motion, and subscribe to their topics only while a page is open.

        If rig time runs too fast to draw (see `Pace.is_followed`), the lab receives no motion. It then receives scans
        only for `SUBSCRIBE_S` at a time, with pauses of `PAUSE_S`. There are no pauses while an action is in progress.
        """
        if self._gateway is None:
            return
        received = self._gateway.take()
        self._listens = self._pace.is_followed or self._gateway.is_busy or not (self._listens and received)
        self._gateway.listen(self.watchers > 0 and self._listens, self._pace.is_followed)

    def _until_next_look(self) -> float:
        if not self.watchers:
            return IDLE_S
        if not self._pace.is_hurried or (self._gateway is not None and self._gateway.is_busy):
            return POLL_S
        if self._pace.is_followed:
            return FAST_RIG_POLL_S
        return SUBSCRIBE_S if self._listens else PAUSE_S

    def _until_next_word(self) -> float:
        if not self._pace.is_followed:
            return SLOWEST_S
        return STATE_S if self.watchers and not self._pace.is_hurried else SLOW_S

    def _take_requests(self) -> None:
        while not self._asked.empty():
            request, answer = self._asked.get()
            if request.do == "choose":
                name = request.values["value"]
                known = name in (self.snapshot.get("rigs") or ())
                self._namespace = name if known else self._namespace
                answer(known, f"showing the rig {name}" if known else f"there is no rig in the namespace {name!r}")
            elif self._gateway is not None:
                self._gateway.begin(request, answer)
            else:
                answer(False, "there is no rig yet; nothing was sent")
        if self._gateway is not None:
            self._gateway.watch()

    def _discover(self) -> None:
        node = self._client.node
        scans = [
            name
            for name, types in node.get_topic_names_and_types()
            if topics.TABLE in types and prefix_of(name, topics.SCAN) is not None and node.count_publishers(name)
        ]
        found = sorted(namespace(prefix) for prefix in prefixes(dict.fromkeys(scans, topics.TABLE)))
        if len(found) == 1:
            self._namespace = found[0]
            return
        words = "Several rigs are running: choose one." if found else "No rig is running yet; searching."
        self.snapshot.put(rigs=found, rig={"word": "choose" if found else "starting", "text": words, "name": ""})

    # State for the page

    def _tell(self) -> None:
        """Update the snapshot, which pages receive, from the newest reports of the nodes and messages of the rig."""
        gateway, record = self._gateway, self.record
        if gateway is None:
            return
        seen = {node: gateway.seen(node) for node in states.BY_NODE}
        rig = seen["rig"]
        if rig.instance != self._instance and not _waits(rig):
            self._instance, record.begun_at_s = rig.instance, time.monotonic() - LATE_S
        record.told_start_ns = LAST_NS if _waits(rig) else _stamp(rig.figures.get("start_ns", ""))
        doubts = self.guard("doubts", record.doubts)
        if doubts is None:
            doubts = ["the lab could not determine whether the measurement applies now"]
        parts: dict[str, Callable[[], Any]] = {
            "sources": lambda: {node: one.part() for node, one in seen.items()},
            "rig": lambda: self._rig(seen, doubts),
            "applied": lambda: record.drive,
            "knobs": lambda: {name: record.knobs.get(name) for name in KNOBS} if record.knobs else None,
            "configuration": lambda: record.configuration,
            "closed_form": lambda: closed_form(record.knobs),
            "dt": lambda: record.curve.part(record.start_ns),
            "dt_now": lambda: state.present(seen["rig"], seen["analysis"], doubts),
            "faults": lambda: None if _waits(rig) or not rig.figures else record.faults.in_force(record.since_ns()),
            "health": lambda: record.health() if seen["analysis"].lives else None,
            "journal": lambda: record.journal.part(record.start_ns),
            "recorder": lambda: self._recorder(seen["recorder"]),
            "lost": lambda: _lost(seen),
            "sweep": lambda: self._sweep(seen["stepped_sine"]),
            "stream": lambda: record.stream_part() if seen["rig"].lives else None,
        }
        self.tell(parts, record.knobs)

    def _rig(self, seen: Mapping[str, Seen], doubts: Sequence[str]) -> dict[str, Any]:
        rig = seen["rig"]
        word, words = state.judge(rig, seen["analysis"], doubts)
        rig_s = figure(rig.figures.get("rig_time_s"))
        over = {name: count for name in CHANNELS if (count := figure(rig.figures.get(f"over_range.{name}")))}
        return {
            "word": word, "text": words, "waits": _waits(rig),
            "name": self._client.node.get_namespace(), "instance": rig.instance,
            "age": round(rig.age_s or 0.0), "time": rig_s,
            "speed": round(self._pace.read(rig_s or 0.0, rig.instance, stands=rig.state in STANDING), 2),
            "mode": rig.figures.get("mode", ""), "own": self._own is not None,
            "realised": figure(rig.figures.get("realised_restitution")), "over": over,
            "motion": self._pace.is_followed,
        }  # fmt: skip

    def _recorder(self, seen: Seen) -> dict[str, Any]:
        directory = seen.figures.get("directory", "")
        if directory:
            self.directory = Path(directory)
        return {
            "lives": seen.lives,
            "gone": seen.gone,
            "state": seen.state,
            "reason": seen.reason,
            "name": Path(directory).name,
            "megabytes": figure(seen.figures.get("megabytes")),
        }

    def _sweep(self, seen: Seen) -> dict[str, Any]:
        return {
            "text": self._client.status("stepped_sine").message if seen.lives else "",
            "state": seen.state,
            "done": figure(seen.figures.get("points_done")),
            "of": figure(seen.figures.get("points")),
        }


def _waits(rig: Seen) -> bool:
    """Return whether the rig reports, but its time has not started.

    All known data then belong to the previous rig.
    """
    return rig.lives and "rig_time_s" not in rig.figures


def _stamp(text: str) -> int:
    """Convert a stamp in the diagnostics to an integer [ns]; 0 if it is missing or not a number."""
    return int(text) if re.fullmatch("[0-9]{1,19}", text) else 0


def _lost(seen: Mapping[str, Seen]) -> dict[str, float] | None:
    """Return the numbers of lost blocks and scans, by a text for the page that describes the loss.

    Losses of zero are left out. The result is None if no node has reported such a number.

    Args:
        seen: last report of each node.
    """
    found = {
        "blocks withheld by a fault": seen["rig"].figures.get("lost_blocks"),
        "scans missed by the analysis": seen["analysis"].figures.get("lost_scans"),
        "blocks missed by the recorder": seen["recorder"].figures.get(f"lost.{SCAN.name}"),
    }
    counts = {name: count for name, value in found.items() if (count := figure(value)) is not None}
    return {name: count for name, count in counts.items() if count} if counts else None
