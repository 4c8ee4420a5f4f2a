# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""How deeds reach the graph: services, parameters and topics of a live rig, without waiting for anything."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any  # rclpy handles; what parameters may be

from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.parameter import parameter_value_to_python
from std_srvs.srv import SetBool, Trigger

from impact_rig import topics
from impact_rig.client.parameters import ros_parameters
from impact_rig.lab import deeds, parts
from impact_rig.lab.deeds import ANSWER_S, READ
from impact_rig.lab.parts import figure
from impact_rig.lab.tasks import Refused, Waiting
from impact_rig.nodes import messages
from impact_rig.runs import recover

if TYPE_CHECKING:
    from impact_rig.lab.live import LiveSource


class Hands:
    """How deeds reach the graph; see `deeds.Hands`."""

    def __init__(self, source: LiveSource) -> None:
        self._source = source
        self._publishers: dict[str, Any] = {}
        if source.ears is None:
            return
        for name in ("rig/stop", "rig/reset", "rig/pluck", "rig/clear_trip", "recorder/start", "recorder/stop"):
            source.client.prepare(Trigger, name)  # made early, it has been discovered when it is used
        source.client.prepare(SetBool, "rig/pause")
        for node in ("rig", "analysis"):
            source.client.prepare(SetParametersAtomically, f"{node}/set_parameters_atomically")
        source.client.prepare(GetParameters, "rig/get_parameters")
        for topic in (topics.FREQUENCY, topics.CURRENT, topics.NOTES):
            self._publishers[topic.name] = source.client.node.create_publisher(
                messages.class_of(topic), topic.name, messages.profile(topic.qos)
            )

    @property
    def knobs(self) -> Mapping[str, Any]:
        """Return the parameters in force, as far as they are known."""
        return self._source.knobs

    @property
    def current_a(self) -> float:
        """Return the current that is applied."""
        applied = self._source.ears.applied
        return float(applied[-1]["current"]) if applied else 0.0

    def is_there(self, node: str) -> bool:
        """Return whether a node was ever heard of."""
        return node in self._source.client.diagnostics

    def heard_of(self, node: str) -> bool:
        """Return whether a node says something."""
        return self.is_there(node) and not self._source.quiet(node)

    def _call(self, service_type: Any, name: str, request: Any, timeout_s: float = ANSWER_S) -> deeds.Answer:
        client = self._source.client.prepare(service_type, name)
        yield Waiting(lambda: client.service_is_ready() or None, f"the service {name}: is its node there?", timeout_s)
        future = client.call_async(request)
        return (
            yield Waiting(
                lambda: future.result() if future.done() else None,
                f"an answer of {name}",
                timeout_s,
                lambda: client.remove_pending_request(future),
            )
        )

    def trigger(self, name: str, timeout_s: float = ANSWER_S) -> deeds.Answer:
        """Call a Trigger service and return its message."""
        response = yield from self._call(Trigger, name, Trigger.Request(), timeout_s)
        if not response.success:
            raise Refused(response.message)
        return str(response.message)

    def pause(self, paused: bool) -> deeds.Answer:
        """Call ~/pause."""
        response = yield from self._call(SetBool, "rig/pause", SetBool.Request(data=paused))
        if not response.success:
            raise Refused(response.message)
        return str(response.message)

    def set_parameters(self, node: str, values: Mapping[str, Any]) -> deeds.Answer:
        """Set parameters of a node."""
        request = SetParametersAtomically.Request(parameters=[one.to_parameter_msg() for one in ros_parameters(values)])
        response = yield from self._call(SetParametersAtomically, f"{node}/set_parameters_atomically", request)
        if not response.result.successful:
            raise Refused(response.result.reason)

    def refresh(self) -> deeds.Answer:
        """Read the knobs again."""
        request = GetParameters.Request(names=list(READ))
        response = yield from self._call(GetParameters, "rig/get_parameters", request)
        if len(response.values) == len(READ):
            values = [parameter_value_to_python(value) for value in response.values]
            self._source.knobs = {
                name: value if isinstance(value, bool | int | float | str) else list(value or ())
                for name, value in zip(READ, values, strict=True)
            }
            self._source.snapshot.put("closed_form", parts.closed_form(self._source.knobs))
            self._source.tell()

    def publish(self, topic: str, value: Any) -> None:
        """Publish a command or remark."""
        publisher = self._publishers[topic]
        if not publisher.get_subscription_count():
            raise Refused(f"nobody listens to {topic}: is the rig there?")
        publisher.publish(publisher.msg_type(data=value))

    def echo(self, topic: str) -> Callable[[str, float], Any]:
        """Return a check for the row in shaker/applied with a value, or the refusal, that come from now on."""
        source = self._source
        known, refused = list(source.ears.applied), self._refusals(topic)

        def check(column: str, value: float) -> Any:
            rows = source.ears.applied
            new = rows if not known else [row for row in rows if not any(row is one for one in known)]
            if any(row[column] == value for row in new):
                source.tell()
                return True
            now = self._refusals(topic)
            for reason, (count, words) in now.items():
                if count > refused.get(reason, (0.0, ""))[0]:
                    raise Refused(words)
            return None

        return check

    def _refusals(self, topic: str) -> dict[str, tuple[float, str]]:
        figures = self._source.client.figures("rig")
        return {
            reason: (figure(figures.get(f"refused.{reason}")) or 0.0, figures.get(f"last_refused.{reason}", ""))
            for reason in (topic, "inactive")
        }

    def start_process(self, node: str) -> bool:
        """Start a node if it is not there; False: it is."""
        if self.heard_of(node):
            return False
        own = self._source.own
        if own is None:
            raise Refused(f"there is no node {node}: start it beside the rig (ros2 run impact_rig {node}_node)")
        if node in own.processes.running:
            own.processes.stop(node)
        self._source.start_node(node)
        return True

    def restart(self) -> str:
        """Start again what has ended."""
        own = self._source.own
        if own is None:
            raise Refused("this lab has not started the rig: start it where it was started")
        ended = [name for name, process in own.processes.running.items() if process.exit_code is not None]
        if not ended:
            raise Refused("every process runs")
        for name in ended:
            own.processes.stop(name)
            self._source.client.diagnostics.pop(name, None)
            self._source.start_node(name)
        return f"started again: {', '.join(ended)}"

    def recover(self) -> str:
        """Recover the last recording."""
        directory = self._source.client.figures("recorder").get("directory", "")
        if self.heard_of("recorder") or not directory:
            raise Refused("the recorder is there: nothing needs to be recovered")
        target = Path(f"{directory}_recovered")
        report = recover(directory, target)
        return f"recovered into {report.out.name if hasattr(report, 'out') else target.name}"

    def choose(self, name: str) -> str:
        """Look at another rig."""
        if name not in (self._source.snapshot.get("rigs") or ()):
            raise Refused(f"there is no rig {name!r}")
        self._source.wanted_namespace = name
        return f"looking at {name}"
