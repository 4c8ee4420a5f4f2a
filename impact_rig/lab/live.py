# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The live source: a client of the graph in a thread of its own, that fills rings and snapshot and does what pages ask.

The thread waits for the graph, looks at the data when a picture is due, and never waits for an answer: a service that
hangs does not keep STOP from being sent.
"""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any  # rclpy handles; what parameters may be

import attrs

from impact_rig.errors import ImpactRigError
from impact_rig.instruments.scan import CHANNELS
from impact_rig.lab import deeds, parts, state
from impact_rig.lab.deeds import KNOBS
from impact_rig.lab.motion import Motion
from impact_rig.lab.pace import Pace
from impact_rig.lab.parts import figure
from impact_rig.lab.protocol import Request
from impact_rig.lab.scope import Scope
from impact_rig.lab.source import Answer, Snapshot, be_gentle
from impact_rig.lab.tasks import Steps, Tasks
from impact_rig.lab.theory import Theory
from impact_rig.topics import SCAN

LOOK_S = 0.02
"""Between two looks at the data while a page is open."""
GLANCE_S = 0.5
"""The same while rig time runs ahead of ours."""
IDLE_S = 0.2
STATE_S = 0.1
SLOW_S = 0.5
NODES = ("rig", "analysis", "recorder")


@attrs.frozen
class Own:
    """The nodes that the lab itself has started, or is to start.

    Attributes:
        processes: of `impact_rig.client`.
        parameters: of each node, by its name.
    """

    processes: Any
    parameters: Mapping[str, Mapping[str, Any]]


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
        self._nothing = threading.Lock(), Motion()
        self._domain_id, self._namespace, self.own = domain_id, namespace, own
        self._asked: queue.SimpleQueue[tuple[Request, Answer]] = queue.SimpleQueue()
        self._watchers = 0
        self._end = threading.Event()
        self._starter = ThreadPoolExecutor(1, thread_name_prefix="lab-starter")
        self._tasks = Tasks()
        self.ears: Any = None
        self.client: Any = None
        self._view: Any = None
        self.knobs: dict[str, Any] = {}
        self._read = -1
        self._failures: dict[str, str] = {}
        self._pace = Pace()
        self._theory = Theory(lambda found: self.snapshot.put("prediction", found))
        self._heard_at: dict[str, tuple[int, float]] = {}
        self.wanted_namespace: str | None = None
        self._thread = threading.Thread(target=self._run, name="lab-hub", daemon=True)
        self.snapshot.put("mode", "live")
        self.snapshot.put("choices", parts.choices())
        self.snapshot.put("rig", {"word": "starting", "text": "The lab starts.", "name": namespace or ""})

    # Source

    @property
    def scope(self) -> Scope | None:
        """The newest scans."""
        return self.ears.scope if self.ears is not None else None

    @property
    def motion(self) -> Motion:
        """The newest true motion."""
        return self.ears.motion if self.ears is not None else self._nothing[1]

    @property
    def lock(self) -> threading.Lock:
        """Held while they are written or read."""
        return self.ears.lock if self.ears is not None else self._nothing[0]

    @property
    def now_s(self) -> float:
        """The end of the newest scan."""
        scope = self.scope
        return scope.end_s if scope is not None else 0.0

    @property
    def epoch(self) -> int:
        """Counts resets."""
        return self.ears.epoch if self.ears is not None else 0

    def watched(self, count: int) -> None:
        """Know how many pages look."""
        self._watchers = count

    def ask(self, request: Request, answer: Answer) -> None:
        """Do what a page asks for, in the thread of this source."""
        self._asked.put((request, answer))

    def start(self) -> None:
        """Begin."""
        self._starter.submit(time.monotonic).result()  # begins the thread
        self._thread.start()

    def close(self) -> None:
        """End, and leave the graph."""
        self._end.set()
        self._thread.join()
        self._theory.close()
        self._starter.shutdown()

    def __enter__(self) -> LiveSource:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # The thread

    def _run(self) -> None:
        if self.own is not None:
            for node in self.own.parameters:
                self.start_node(node)
        be_gentle()
        try:
            while not self._end.is_set():
                self.wanted_namespace = None
                self._open()
                try:
                    self._serve()
                finally:
                    self._leave()
        except Exception as error:  # without its source the page must say so, not stand still
            self.snapshot.put("rig", {"word": "dead", "text": f"The lab has failed: {error}", "name": ""})
            raise

    def _open(self) -> None:
        from rclpy.node import Node  # noqa: PLC0415  # the page is served before the half second this takes

        from impact_rig.client import Client  # noqa: PLC0415
        from impact_rig.lab.ears import Ears  # noqa: PLC0415
        from impact_rig.lab.hands import Hands  # noqa: PLC0415

        namespace = self._namespace
        self.client = Client(self._domain_id, (namespace or "").strip("/"), name="lab")
        self._read, self._heard_at = -1, {}
        if namespace is None:
            return
        self._view = Node(
            "lab_view", namespace=self.client.node.get_namespace(), context=self.client.context,
            use_global_arguments=False, enable_rosout=False, start_parameter_services=False,
        )  # fmt: skip
        self.ears = Ears(self.client.node, self._view, self._failed)
        self._hands = Hands(self)

    def _leave(self) -> None:
        self._tasks.end("the lab looks elsewhere now")
        ears, self.ears = self.ears, None
        if ears is not None:
            ears.listen(scans=False, motion=False)
        if self._view is not None:
            self._view.destroy_node()
            self._view = None
        self.client.close()

    def _failed(self, where: str, words: str) -> None:
        self._failures[where] = words

    def _serve(self) -> None:
        """Wait for the graph until the next look is due, and so on."""
        look_at = state_at = slow_at = 0.0
        executor = self.client.executor
        while not self._end.is_set() and self.wanted_namespace is None:
            now = time.monotonic()
            if now >= look_at:
                look_at = now + self._until_next_look()
                self._take_requests()
                self._tasks.work()
                if self.ears is not None:
                    self.ears.listen(self._watchers > 0, self._pace.is_followed)
                    self.ears.look()
            if now >= state_at:
                state_at = now + (STATE_S if self._watchers and not self._pace.is_hurried else SLOW_S)
                self.tell()
            if now >= slow_at:
                slow_at = now + SLOW_S
                self._look_around()
            # little comes here; spinning for longer than one message leaks 32 bytes a turn in rclpy, and we turn often
            executor.spin_once(timeout_sec=max(0.0, min(look_at, state_at) - time.monotonic()))
        if self.wanted_namespace is not None:
            self._namespace = self.wanted_namespace

    def _until_next_look(self) -> float:
        if not self._watchers:
            return IDLE_S
        return GLANCE_S if self._pace.is_hurried and not len(self._tasks) else LOOK_S

    def start_node(self, node: str) -> None:
        """Start a process, in a thread that is not as gentle as this source's own."""
        assert self.own is not None
        self._starter.submit(self.own.processes.start, node, self.own.parameters.get(node, {})).result()

    def _take_requests(self) -> None:
        while not self._asked.empty():
            request, answer = self._asked.get()
            if self.ears is None and request.do != "choose":
                answer(False, "there is no rig yet")
            elif self.ears is None:
                self._choose(request.values["value"], answer)
            else:
                self._tasks.begin(deeds.begin(self._hands, request), answer)

    def _choose(self, name: str, answer: Answer) -> None:
        known = name in (self.snapshot.get("rigs") or ())
        if known:
            self.wanted_namespace = name
        answer(known, f"looking at {name}" if known else f"there is no rig {name!r}")

    def _look_around(self) -> None:
        """Do what is not for every picture: knobs that may have changed, other rigs, the compiler."""
        if self.ears is None:
            self._discover()
            return
        if self.ears.configured != self._read and self._hands.is_there("rig"):
            self._read = self.ears.configured
            self._tasks.begin(_silently(self._hands.refresh()), lambda _ok, _words: None)

    def _discover(self) -> None:
        found = sorted(
            name.removesuffix("/daq/scan") or "/"
            for name, _ in self.client.node.get_topic_names_and_types()
            if name.endswith("/daq/scan") and self.client.node.count_publishers(name)
        )
        if len(found) == 1:
            self.wanted_namespace = found[0]
            return
        self.snapshot.put("rigs", found)
        words = "Several rigs are running: choose one." if found else "No rig is running yet: looking for one."
        self.snapshot.put("rig", {"word": "choose" if found else "starting", "text": words, "name": ""})

    # What the page is told

    def tell(self) -> None:
        """Bring the snapshot up to date."""
        if self.ears is None:
            return
        client, ears, put = self.client, self.ears, self.snapshot.put
        figures, status = client.figures("rig"), client.status("rig")
        rig_s = figure(figures.get("rig_time_s"))
        heard = state.Heard(
            ended=self._ended("rig"), age_s=self._age("rig"), message=status.message,
            level=status.level[0] if status.level else 0, figures=figures,
            tripped=ears.ledger.tripped, plucked=ears.ledger.plucked,
            settled=ears.curve.settled_since(ears.ledger.changed_ns),
        )  # fmt: skip
        word, words = state.judge(heard)
        put("rig", {
            "word": word, "text": words, "name": client.node.get_namespace(), "age": round(heard.age_s or 0.0),
            "time": rig_s, "speed": round(self._pace.read(rig_s or 0.0), 2),
            "mode": figures.get("mode", ""), "own": self.own is not None, "faults": figures.get("faults", ""),
            "realised": figure(figures.get("realised_restitution")), "over": _over_range(figures),
            "motion": self._pace.is_followed,
        })  # fmt: skip
        if ears.applied:
            put("applied", ears.applied[-1])
        put("knobs", {name: self.knobs.get(name) for name in KNOBS} if self.knobs else None)
        if self.knobs and ears.applied and self._watchers:
            self._theory.want(self.knobs, ears.applied[-1]["current"])
        put("dt", ears.curve.part(ears.start_ns))
        put("journal", ears.ledger.part(ears.start_ns))
        put("settling", self._settling(word, ears.curve.refusal))
        put("recorder", self._recorder())
        put("lost", self._lost(figures))
        put("sweep", self._sweep())
        put("others", {node: self._ended(node) or self.quiet(node) for node in NODES[1:]})
        if self._failures:
            put("failures", dict(self._failures))

    def _age(self, node: str) -> float | None:
        """Return how long ago a node has said something."""
        status = self.client.diagnostics.get(node)
        if status is None:
            return None
        known = self._heard_at.get(node)
        if known is None or known[0] != id(status):
            self._heard_at[node] = known = (id(status), time.monotonic())
        return time.monotonic() - known[1]

    def quiet(self, node: str) -> str:
        """Return how long a node has been silent, if that is too long; empty otherwise, or where it was never heard."""
        age = self._age(node)
        return f"silent for {age:.0f} s" if age is not None and age > state.DEAD_S else ""

    def _ended(self, node: str) -> str:
        if self.own is None or node not in self.own.processes.running:
            return ""
        code = self.own.processes.running[node].exit_code
        return "" if code is None else f"its process ended with code {code}"

    def _settling(self, word: str, refusal: str) -> dict[str, Any]:
        figures = self.client.figures("analysis")
        return {
            "done": figure(figures.get("settling_windows")), "of": figure(figures.get("settling_windows_needed")),
            "rest": figure(figures.get("settling_remnant")), "word": word, "refusal": refusal.replace("_", " "),
        }  # fmt: skip

    def _recorder(self) -> dict[str, Any]:
        figures, status = self.client.figures("recorder"), self.client.status("recorder")
        directory = figures.get("directory", "")
        return {
            "there": "recorder" in self.client.diagnostics and not self._ended("recorder"),
            "text": status.message, "name": Path(directory).name, "level": status.level[0] if status.level else 0,
            "megabytes": figure(figures.get("megabytes")),
        }  # fmt: skip

    def _lost(self, figures: Mapping[str, str]) -> dict[str, float]:
        found = {
            "withheld": figures.get("lost_blocks"),
            "analysis scans": self.client.figures("analysis").get("lost_scans"),
            "recorder blocks": self.client.figures("recorder").get(f"lost.{SCAN.name}"),
        }
        return {name: count for name, value in found.items() if (count := figure(value))}

    def _sweep(self) -> dict[str, Any]:
        figures = self.client.figures("stepped_sine")
        message = self.client.status("stepped_sine").message
        return {
            "text": message, "running": message.startswith("point"), "done": figure(figures.get("points_done")),
            "of": figure(figures.get("points")),
        }  # fmt: skip


def _silently(steps: deeds.Answer) -> Steps:
    yield from steps
    return ""


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
