# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a page can ask of a live rig: each deed goes through the topics, services and parameters that anybody has."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Mapping
from typing import Any, Protocol  # messages and values of parameters

from impact_rig import topics
from impact_rig.instruments.fault_kinds import FAULT_KINDS
from impact_rig.lab.protocol import Request
from impact_rig.lab.tasks import Refused, Steps, Waiting
from impact_rig.lab.theory import DECIDING

ANSWER_S = 30.0
"""A busy machine answers late: the knob stays pending until then."""
START_S = 60.0
AGAIN_S, ATTEMPTS = 0.5, 20
"""How often a node that has just been started is asked to begin."""
PLANNED = "instruments.faults.planned"
MOST_FAULTS = 16
SWEEPER = "stepped_sine"
KNOBS = (
    "barriers.gap_m", "sphere.present", "sphere.start", "contact.law", "contact.restitution", "pluck.displacement_m",
    "shaker.frequency_min_hz", "shaker.frequency_max_hz", "shaker.current_limit_a_rms", "shaker.travel_limit_m",
    "structure.natural_frequency_hz", "structure.damping_ratio", "time.mode", "time.factor", "drive.kind", PLANNED,
)  # fmt: skip
"""Parameters of the rig that the page shows."""
READ = (*KNOBS, *sorted(set(DECIDING) - set(KNOBS)))
"""Those that are read for it: these, and what theory needs."""
SHAKER = {"frequency": topics.FREQUENCY.name, "current": topics.CURRENT.name}
RIG_KEYS = {"start": "sphere.start", "law": "contact.law", "restitution": "contact.restitution"}
Answer = Generator[Waiting, Any, Any]


class Hands(Protocol):
    """What deeds are done with; a live source has them."""

    def trigger(self, name: str, timeout_s: float = ANSWER_S) -> Answer:
        """Call a Trigger service and return its message."""

    def pause(self, paused: bool) -> Answer:
        """Call ~/pause."""

    def set_parameters(self, node: str, values: Mapping[str, Any]) -> Answer:
        """Set parameters of a node."""

    def refresh(self) -> Answer:
        """Read the knobs again."""

    def publish(self, topic: str, value: Any) -> None:
        """Publish a command or remark."""

    def echo(self, topic: str) -> Callable[[str, float], Any]:
        """Return a check for the row in shaker/applied with a value, or the refusal, that come from now on."""

    def start_process(self, node: str) -> bool:
        """Start a node if it is not there; False: it is."""

    def restart(self) -> str:
        """Start again what has ended."""

    def recover(self) -> str:
        """Recover the last recording."""

    def choose(self, name: str) -> str:
        """Look at another rig."""

    def heard_of(self, node: str) -> bool:
        """Return whether a node says something."""

    @property
    def knobs(self) -> Mapping[str, Any]:
        """Return the parameters in force, as far as they are known."""

    @property
    def current_a(self) -> float:
        """Return the current that is applied."""


def begin(hands: Hands, request: Request) -> Steps:
    """Return the steps of what is asked."""
    do, values = request.do, request.values
    if do in SHAKER:
        return _command(hands, do, values["value"])
    if do in RIG_KEYS:
        return _set(hands, {RIG_KEYS[do]: values["value"]})
    return _DEEDS[do](hands, values) if do in _DEEDS else _not_here(do)


def _command(hands: Hands, column: str, value: float) -> Steps:
    echo = hands.echo(SHAKER[column])
    hands.publish(SHAKER[column], value)
    yield Waiting(lambda: echo(column, value), f"{column} {value:g} in shaker/applied", ANSWER_S)
    return f"{column} {value:g}"


def _set(hands: Hands, values: Mapping[str, Any], node: str = "rig") -> Steps:
    yield from hands.set_parameters(node, values)
    yield from hands.refresh()
    return ", ".join(f"{name} = {value}" for name, value in values.items())


def _gap(hands: Hands, values: Mapping[str, Any]) -> Steps:
    """Set the gap of the rig and the label of the analysis together; 0 takes the sphere away."""
    gap = values["value"]
    change = {"sphere.present": True, "barriers.gap_m": gap} if gap != 0.0 else {"sphere.present": False}
    yield from hands.set_parameters("rig", change)
    yield from hands.refresh()
    yield from hands.set_parameters("analysis", {"gap_m": gap})
    return f"gap {gap * 1e3:g} mm" if gap else "no sphere"


def _present(hands: Hands, values: Mapping[str, Any]) -> Steps:
    gap = float(hands.knobs.get("barriers.gap_m", math.nan)) if values["value"] else 0.0
    return (yield from _gap(hands, {"value": gap}))


def _pluck(hands: Hands, values: Mapping[str, Any]) -> Steps:
    yield from hands.set_parameters("rig", {"pluck.displacement_m": values["value"]})
    return (yield from hands.trigger("rig/pluck"))


def _reset(hands: Hands, _values: Mapping[str, Any]) -> Steps:
    words = yield from hands.trigger("rig/reset")
    yield from hands.refresh()
    return str(words)


def _pause(hands: Hands, values: Mapping[str, Any]) -> Steps:
    return (yield from hands.pause(values["value"]))


def _sweep(hands: Hands, values: Mapping[str, Any]) -> Steps:
    was_there = not hands.start_process(SWEEPER)
    if not was_there:
        yield Waiting(lambda: hands.heard_of(SWEEPER) or None, f"the node {SWEEPER}", START_S)
    plan = {
        "frequencies_hz": list(values["frequencies"]),
        "direction": values["direction"],
        "current_a": hands.current_a or 0.52,
        "hold": values["hold"],
        **({"target": values["target"]} if values["hold"] in ("current", "base", "superior") else {}),
    }
    yield from hands.set_parameters(SWEEPER, plan)
    attempts = 1 if was_there and values["hold"] != "phase" else ATTEMPTS
    while True:
        attempts -= 1
        try:
            return str((yield from hands.trigger(f"{SWEEPER}/start")))
        except Refused:  # a node that has just begun has not heard of the rig yet, or of its scans
            if not attempts:
                raise
        again = time.monotonic() + AGAIN_S
        yield Waiting(lambda again=again: time.monotonic() > again or None, "a moment", START_S)  # type: ignore[misc]


def _fault(hands: Hands, values: Mapping[str, Any]) -> Steps:
    """Add a line to the planned faults: a new one begins now."""
    if values["kind"] not in FAULT_KINDS:
        raise Refused(f"there is no fault {values['kind']!r}")
    words = [str(values["kind"])]
    if values["channel"]:
        words.append(f"channel={values['channel']}")
    words += [f"duration_s={values['duration']:g}", f"value={values['value']!r}", f"rate_hz={values['rate']:g}"]
    lines = [line for line in hands.knobs.get(PLANNED) or () if line][-(MOST_FAULTS - 1) :]
    yield from hands.set_parameters("rig", {PLANNED: [*lines, " ".join(words)]})
    yield from hands.refresh()
    return f"fault: {' '.join(words)}"


def _clear_faults(hands: Hands, _values: Mapping[str, Any]) -> Steps:
    yield from hands.set_parameters("rig", {PLANNED: [""]})
    yield from hands.refresh()
    return "faults cleared"


def _note(hands: Hands, values: Mapping[str, Any]) -> Steps:
    if not values["value"].strip():
        raise Refused("a remark has words")
    hands.publish("notes", values["value"])
    return "noted"
    yield  # a generator like the others


def _record(hands: Hands, values: Mapping[str, Any]) -> Steps:
    return (yield from hands.trigger("recorder/start" if values["value"] else "recorder/stop", 20.0))


def _at_once(action: Callable[[Hands, Mapping[str, Any]], str]) -> Callable[[Hands, Mapping[str, Any]], Steps]:
    def deed(hands: Hands, values: Mapping[str, Any]) -> Steps:
        return action(hands, values)
        yield  # a generator like the others

    return deed


def _service(name: str) -> Callable[[Hands, Mapping[str, Any]], Steps]:
    def deed(hands: Hands, _values: Mapping[str, Any]) -> Steps:
        return str((yield from hands.trigger(name)))

    return deed


def _not_here(do: str) -> Steps:
    raise Refused(f"{do}: a live rig cannot do that")
    yield  # a generator like the others


_DEEDS: Mapping[str, Callable[[Hands, Mapping[str, Any]], Steps]] = {
    "gap": _gap,
    "present": _present,
    "stop": _service("rig/stop"),
    "clear_trip": _service("rig/clear_trip"),
    "reset": _reset,
    "pluck": _pluck,
    "pause": _pause,
    "sweep": _sweep,
    "sweep_stop": _service(f"{SWEEPER}/stop"),
    "fault": _fault,
    "clear_faults": _clear_faults,
    "note": _note,
    "record": _record,
    "restart": _at_once(lambda hands, _values: hands.restart()),
    "recover": _at_once(lambda hands, _values: hands.recover()),
    "choose": _at_once(lambda hands, values: hands.choose(values["value"])),
}
