# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The live source: a client of the graph in one event loop, that fills rings and snapshot and does what pages ask.

The loop waits for the graph, looks at the data when a picture is due, and never waits for an answer: a service that
hangs does not keep STOP from being sent, nor does a message without sense.
"""

from __future__ import annotations

import asyncio
import functools
import os
import queue
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any  # rclpy handles; what goes to JSON

from impact_rig import states
from impact_rig.errors import ImpactRigError
from impact_rig.instruments.section import CHANNELS
from impact_rig.lab import state
from impact_rig.lab.motion import Motion
from impact_rig.lab.protocol import Request
from impact_rig.lab.scope import Scope
from impact_rig.lab.source import Answer, Snapshot, be_gentle
from impact_rig.lab.state import KNOBS, Pace, Seen, figure
from impact_rig.lab.theory import Theory, contradiction
from impact_rig.topics import SCAN

if TYPE_CHECKING:
    from rclpy.node import Node

    from impact_rig.client.client import Client
    from impact_rig.lab.gateway import Gateway, Own
    from impact_rig.lab.subscriptions import Subscriptions

LOOK_S = 0.02
"""Between two looks at the data while a page is open."""
GLANCE_S = 0.5
"""The same while rig time runs ahead of ours."""
TURN_S = 0.05
"""The longest turn of the loop while a page is open: what it asks for waits no longer."""
IDLE_S = 0.2
STATE_S = 0.1
SLOW_S = 0.5


class LiveSource:
    """A rig of the graph.

    Args:
        domain_id: ROS domain.
        namespace: of the rig; None: look for one.
        own: to start nodes with; None: those of others are only looked at.
    """

    def __init__(self, domain_id: int, namespace: str | None, own: Own | None = None) -> None:
        self.snapshot = Snapshot()
        self.other: Scope | None = None
        self.directory: Path | None = None
        """Where the recorder has written last."""
        self._nothing = threading.Lock(), Motion()
        self._domain_id, self._namespace, self._own = domain_id, namespace, own
        self._asked: queue.SimpleQueue[tuple[Request, Answer]] = queue.SimpleQueue()
        self._watchers = 0
        self._end = threading.Event()
        self._client: Client
        self._view: Node | None = None
        self._heard: Subscriptions | None = None
        self._gateway: Gateway | None = None
        self._heard_at: dict[str, tuple[Any, float]] = {}
        self._refused: dict[str, list[Any]] = {}
        self._pace = Pace()
        self._theory = Theory(lambda found: self.snapshot.put("prediction", found))
        self._wanted_namespace: str | None = None
        self._thread = threading.Thread(target=self._run, name="lab-hub", daemon=True)
        self.snapshot.put("mode", "live")
        self.snapshot.put("choices", state.choices())
        self.snapshot.put("help", state.glossary())
        self.snapshot.put("rig", {"word": "starting", "text": "The lab starts.", "name": namespace or ""})

    # Source

    @property
    def scope(self) -> Scope | None:
        """The newest scans."""
        return self._heard.scope if self._heard is not None else None

    @property
    def motion(self) -> Motion:
        """The newest true motion."""
        return self._heard.motion if self._heard is not None else self._nothing[1]

    @property
    def lock(self) -> threading.Lock:
        """Held while they are written or read."""
        return self._heard.lock if self._heard is not None else self._nothing[0]

    @property
    def now_s(self) -> float:
        """The end of the newest scan."""
        scope = self.scope
        return scope.end_s if scope is not None else 0.0

    @property
    def epoch(self) -> int:
        """Counts resets."""
        return self._heard.epoch if self._heard is not None else 0

    def watched(self, count: int) -> None:
        """Know how many pages look."""
        self._watchers = count

    def ask(self, request: Request, answer: Answer) -> None:
        """Do what a page asks for, in the loop of this source."""
        self._asked.put((request, answer))

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def close(self) -> None:
        """End, and leave the graph."""
        self._end.set()
        if self._thread.is_alive():  # else what kept it from starting is the error to be seen
            self._thread.join()
        self._theory.close()
        if self._own is not None:
            self._own.close()

    def __enter__(self) -> LiveSource:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # The loop

    def _run(self) -> None:
        try:
            if self._own is not None:
                for node in self._own.parameters:
                    self._own.start(node)
            be_gentle()
            asyncio.run(self._serve_rigs())
        except Exception as error:  # without its source the page must say so, not stand still
            self.snapshot.put("rig", {"word": "dead", "text": f"The lab has failed: {error}", "name": ""})
            raise

    async def _serve_rigs(self) -> None:
        while not self._end.is_set():
            self._wanted_namespace = None
            self._open()
            try:
                await self._serve()
            finally:
                await self._leave()

    def _open(self) -> None:
        from rclpy.node import Node  # noqa: PLC0415  # the page is served before the half second this takes

        from impact_rig.client.client import Client  # noqa: PLC0415
        from impact_rig.lab.gateway import Gateway  # noqa: PLC0415
        from impact_rig.lab.subscriptions import Subscriptions  # noqa: PLC0415

        namespace = self._namespace
        self._client = Client(self._domain_id, (namespace or "").strip("/"), name="lab")
        self._heard_at = {}
        self._refused.clear()
        if namespace is None:
            return
        self._view = Node(
            "lab_view", namespace=self._client.node.get_namespace(), context=self._client.context,
            use_global_arguments=False, enable_rosout=False, start_parameter_services=False,
        )  # fmt: skip
        self._heard = Subscriptions(self._client.node, self._view, self._refused)
        self._gateway = Gateway(self._client, self._heard, self._seen, self._own, self._choose)

    async def _leave(self) -> None:
        self._guard("state", self._tell)  # the last words of the recorder say where it has written
        if self._gateway is not None:
            self._gateway.end("the lab looks elsewhere now")
            await asyncio.sleep(0)
        heard, self._heard, self._gateway = self._heard, None, None
        if heard is not None:
            heard.listen(scans=False, motion=False)
        if self._view is not None:
            self._view.destroy_node()
            self._view = None
        self._client.close()

    async def _serve(self) -> None:
        """Wait for the graph until the next look is due, and so on."""
        look_at = state_at = slow_at = 0.0
        while not self._end.is_set() and self._wanted_namespace is None:
            now = time.monotonic()
            self._guard("requests", self._take_requests)
            if now >= look_at:
                look_at = now + self._until_next_look()
                self._guard("pictures", self._look)
            if now >= state_at:
                state_at = now + (STATE_S if self._watchers and not self._pace.is_hurried else SLOW_S)
                self._guard("state", self._tell)
            if self._heard is None and now >= slow_at:
                slow_at = now + SLOW_S
                self._guard("discovery", self._discover)
            # little comes here; spinning for longer than one message leaks 32 bytes a turn in rclpy, and we turn often
            wait_s = max(0.0, min(look_at, state_at) - time.monotonic())
            wait_s = min(wait_s, TURN_S) if self._watchers else wait_s
            self._guard("/diagnostics", functools.partial(self._client.executor.spin_once, timeout_sec=wait_s))
            await asyncio.sleep(0)  # every action looks whether what it waits for has come
        if self._wanted_namespace is not None:
            self._namespace = self._wanted_namespace

    def _guard(self, what: str, work: Callable[[], Any]) -> None:
        """Do a part of a turn; whatever fails in it, the loop goes on: STOP is sent from here."""
        try:
            work()
        except Exception as error:  # what others publish comes in here
            from impact_rig.nodes.guard import describe  # noqa: PLC0415  # see `_open`

            count = self._refused.setdefault(what, [0, ""])
            count[0] += 1
            count[1] = describe(error)

    def _look(self) -> None:
        if self._heard is not None:
            self._heard.listen(self._watchers > 0, self._pace.is_followed)
            self._heard.look()

    def _until_next_look(self) -> float:
        if not self._watchers:
            return IDLE_S
        return GLANCE_S if self._pace.is_hurried and not self._gateway else LOOK_S

    def _take_requests(self) -> None:
        while not self._asked.empty():
            request, answer = self._asked.get()
            if self._gateway is not None:
                self._gateway.begin(request, answer)
            elif request.do == "choose" and request.values["value"] in (self.snapshot.get("rigs") or ()):
                self._choose(request.values["value"])
                answer(True, f"looking at {request.values['value']}")
            else:
                answer(False, "there is no rig yet")
        if self._gateway is not None:
            self._gateway.watch()

    def _choose(self, name: str) -> None:
        if name not in (self.snapshot.get("rigs") or ()):
            raise ImpactRigError(f"there is no rig {name!r}")
        self._wanted_namespace = name

    def _discover(self) -> None:
        found = sorted(
            name.removesuffix("/daq/scan") or "/"
            for name, _ in self._client.node.get_topic_names_and_types()
            if name.endswith("/daq/scan") and self._client.node.count_publishers(name)
        )
        if len(found) == 1:
            self._wanted_namespace = found[0]
            return
        self.snapshot.put("rigs", found)
        words = "Several rigs are running: choose one." if found else "No rig is running yet: looking for one."
        self.snapshot.put("rig", {"word": "choose" if found else "starting", "text": words, "name": ""})

    # What is known of nodes

    def _seen(self, node: str) -> Seen:
        """Return what a node has said last, and how long ago."""
        status = self._client.diagnostics.get(node)
        ended = self._own.ended(node) if self._own is not None else ""
        if status is None:
            return Seen(ended=ended)
        known = self._heard_at.get(node)
        if known is None or known[0] is not status:
            self._heard_at[node] = known = (status, time.monotonic())
        return Seen.of(node, self._client.figures(node), time.monotonic() - known[1], ended)

    # What the page is told

    def _tell(self) -> None:
        """Bring the snapshot up to date, part by part: one that cannot be told does not keep the others back."""
        heard = self._heard
        if heard is None:
            return
        seen = {node: self._seen(node) for node in states.BY_NODE}
        parts: dict[str, Callable[[], Any]] = {
            "sources": lambda: {node: one.part() for node, one in seen.items()},
            "rig": lambda: self._rig(seen, heard),
            "applied": lambda: heard.applied[-1] if heard.applied else None,
            "knobs": lambda: {name: heard.knobs.get(name) for name in KNOBS} if heard.knobs else None,
            "configuration": lambda: heard.configuration,
            "closed_form": lambda: state.closed_form(heard.knobs),
            "dt": lambda: heard.curve.part(heard.start_ns),
            "dt_now": lambda: state.present(seen["rig"], seen["analysis"]),
            "faults": lambda: heard.faults.in_force(heard.start_ns),
            "health": lambda: heard.curve.health() if seen["analysis"].lives else None,
            "journal": lambda: heard.journal.part(heard.start_ns),
            "recorder": lambda: self._recorder(seen["recorder"]),
            "lost": lambda: _lost(seen),
            "sweep": lambda: self._sweep(seen["stepped_sine"]),
            "refused": lambda: {name: list(found) for name, found in self._refused.items()},
        }
        for name, make in parts.items():
            self._guard(f"state of {name}", lambda name=name, make=make: self.snapshot.put(name, make()))  # type: ignore[misc]
        if heard.knobs and heard.applied and self._watchers:
            self._theory.want(heard.knobs, heard.applied[-1]["current"])
        rows, now = self.snapshot.get("dt"), self.snapshot.get("dt_now")
        prediction = self.snapshot.get("prediction") or {}
        self.snapshot.put("other_motion", contradiction(prediction, rows[-1]["ipc"]) if rows and now["holds"] else "")

    def _rig(self, seen: Mapping[str, Seen], heard: Subscriptions) -> dict[str, Any]:
        rig = seen["rig"]
        doubts = [f"{fault} is in force (truth)" for fault in heard.faults.in_force(heard.start_ns)]
        doubts += [f"{channel}: {word}" for channel, word in (heard.curve.health() or {}).items()]
        word, words = state.judge(rig, seen["analysis"], doubts)
        rig_s = figure(rig.figures.get("rig_time_s"))
        return {
            "word": word, "text": words, "name": self._client.node.get_namespace(), "instance": rig.instance,
            "age": round(rig.age_s or 0.0), "time": rig_s, "speed": round(self._pace.read(rig_s or 0.0), 2),
            "mode": rig.figures.get("mode", ""), "own": self._own is not None,
            "realised": figure(rig.figures.get("realised_restitution")), "over": _over_range(rig.figures),
            "motion": self._pace.is_followed,
        }  # fmt: skip

    def _recorder(self, seen: Seen) -> dict[str, Any]:
        directory = seen.figures.get("directory", "")
        if directory:
            self.directory = Path(directory)
        return {
            "lives": seen.lives, "gone": seen.gone, "state": seen.state, "reason": seen.reason,
            "name": Path(directory).name, "megabytes": figure(seen.figures.get("megabytes")),
        }  # fmt: skip

    def _sweep(self, seen: Seen) -> dict[str, Any]:
        return {
            "text": self._client.status("stepped_sine").message if seen.lives else "", "state": seen.state,
            "done": figure(seen.figures.get("points_done")), "of": figure(seen.figures.get("points")),
        }  # fmt: skip


def _lost(seen: Mapping[str, Seen]) -> dict[str, float]:
    """Return what was lost and where, in words; None where nobody counts any more."""
    found = {
        "blocks withheld by a fault": seen["rig"].figures.get("lost_blocks"),
        "scans missed by the analysis": seen["analysis"].figures.get("lost_scans"),
        "blocks missed by the recorder": seen["recorder"].figures.get(f"lost.{SCAN.name}"),
    }
    return {name: count for name, value in found.items() if (count := figure(value))}


def _over_range(figures: Mapping[str, str]) -> dict[str, float]:
    found = {name: figure(figures.get(f"over_range.{name}")) or 0.0 for name in CHANNELS}
    return {name: count for name, count in found.items() if count}


def domain_id() -> int:
    """Return the ROS domain of the environment.

    Raises:
        ImpactRigError: it is no number.
    """
    value = os.environ.get("ROS_DOMAIN_ID", "0") or "0"
    if not value.isdigit():
        raise ImpactRigError(f"ROS_DOMAIN_ID must be a number, got {value!r}")
    return int(value)
