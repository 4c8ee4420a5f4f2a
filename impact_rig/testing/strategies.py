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
"""Search for failures of a pipeline with random scenarios, drawn by Hypothesis.

A scenario is a list of actions: operator actions, instrument faults and disturbances of callbacks. `search` plays many
scenarios, each on a new rig with the test's own `check`. It reports the shortest failing scenario that it finds, with
three lines of Python that repeat it. Requires the extra `impact_rig[strategies]`.
"""

from __future__ import annotations

import contextlib
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any  # Any: value of a parameter or message

import attrs
from hypothesis import Phase, given, seed, settings
from hypothesis import strategies as st

from impact_rig.driver import RigDriver
from impact_rig.errors import CommandError, ConfigError
from impact_rig.instruments.fault import Fault
from impact_rig.instruments.instrument import BOARD_KINDS
from impact_rig.instruments.registry import INSTRUMENTS

if TYPE_CHECKING:
    from impact_rig.testing.schedule import LocalRigWithNodes

__all__ = [
    "Burst", "Call", "Command", "Delay", "Drop", "Duplicate", "First", "Inject", "LateJoin", "ParameterChange", "Pause",
    "Reset", "Send", "SetParameter", "Silence", "repeat", "scenarios", "schedules", "search",
]  # fmt: skip

AFTERWARDS = 3  # blocks that follow the last action, so that the pipeline receives its effect
MOST_BLOCKS = 20  # maximum length of an action, and of the wait for the end of faults
SEED = 2
"""Seed of `search`: each run of a test plays the same scenarios, whatever the layout of this source."""


@attrs.frozen
class Command:
    """Operator's command of drive frequency [Hz] and peak current [A]; None leaves a value unchanged."""

    frequency_hz: float | None = None
    current_a: float | None = None

    def do(self, rig: RigDriver) -> None:
        """Send the command to the rig, and return when the rig has accepted it."""
        rig.command(self.frequency_hz, self.current_a)


@attrs.frozen
class ParameterChange:
    """Change of a parameter of the rig, named by its full name such as `barriers.gap_m`."""

    key: str
    value: float | bool

    def do(self, rig: RigDriver) -> None:
        """Change the parameter of the rig."""
        rig.configure({self.key: self.value})


@attrs.frozen
class Inject:
    """Fault of an instrument for `blocks` blocks from now on.

    Without `channel`, it is a fault of the whole board. `kind` and `value` are those of a `Fault`.
    """

    kind: str
    channel: str = ""
    blocks: int = 1
    value: float = 0.0

    def do(self, rig: RigDriver) -> None:
        """Inject the fault into the rig."""
        begin, length = rig.frontier_sample, self.blocks * rig.block_scans
        rig.inject(Fault(kind=self.kind, channel=self.channel, start_sample=begin, samples=length, value=self.value))


@attrs.frozen
class Pause:
    """Pause of the actions: the rig runs `blocks` blocks without any."""

    blocks: int = 1

    def do(self, rig: RigDriver) -> None:
        """Advance the rig by `blocks` blocks."""
        rig.step(self.blocks)


@attrs.frozen
class Silence:
    """Silence of the operator for `blocks` blocks, with a shorter command timeout of the rig.

    The timeout is half of the time of these blocks. Unless a node under test sends a command, the rig therefore ramps
    down after half of the blocks at the latest.
    """

    blocks: int = 2

    def do(self, rig: RigDriver) -> None:
        """Advance the rig by `blocks` blocks; meanwhile, the command timeout is half of this rig time."""
        before = rig.config.output.command_timeout_s
        seconds = self.blocks * rig.block_scans / rig.rate_hz
        rig.configure({"output.command_timeout_s": 0.5 * seconds})
        rig.step(self.blocks)
        rig.configure({"output.command_timeout_s": before})


@attrs.frozen
class Reset:
    """Reset of the rig to scan 0 at rest, after `after` further callbacks of all hosted nodes together.

    Nothing happens if the rig rejects the reset, for example because its shaker is stopped.
    """

    after: int = 0

    def do(self, rig: RigDriver) -> None:
        """Reset the rig after `after` further callbacks of all hosted nodes together, unless it rejects the reset."""
        nodes = with_nodes(rig)

        def reset() -> None:
            with contextlib.suppress(CommandError, ConfigError):  # called later, where `repeat` catches nothing
                nodes.reset()

        nodes.after(self.after, reset)


@attrs.frozen
class LateJoin:
    """Late start of the pipeline, after the rig has run `blocks` blocks.

    After the beginning of a scenario, the action only advances the rig by `blocks` blocks.
    """

    blocks: int = 1

    def do(self, rig: RigDriver) -> None:
        """Advance the rig by `blocks` blocks."""
        rig.step(self.blocks)


@attrs.frozen
class Delay:
    """Delay of messages or timers for `blocks` blocks.

    `source` is a topic, `"timers"` for all timers, or `"messages"` for the messages of all topics. The messages are
    delivered afterwards in their order. A full queue loses its oldest message.
    """

    source: str
    blocks: int = 1

    def do(self, rig: RigDriver) -> None:
        """Hold the callbacks of `source` back during the next `blocks` blocks, without advancing the rig."""
        with_nodes(rig).hold(self.source, self.blocks)


@attrs.frozen
class First:
    """Priority of a topic or of the timers (`"timers"`) over all other callbacks, for `blocks` blocks."""

    source: str
    blocks: int = 1

    def do(self, rig: RigDriver) -> None:
        """Prefer the callbacks of `source` to all others during the next `blocks` blocks, without advancing the rig."""
        with_nodes(rig).prefer(self.source, self.blocks)


@attrs.frozen
class Burst:
    """Pause of all executors for `blocks` blocks; then they run everything that has queued up."""

    blocks: int = 2

    def do(self, rig: RigDriver) -> None:
        """Hold back the callbacks of all messages and timers in the next `blocks` blocks, without advancing the rig."""
        for source in ("messages", "timers"):
            with_nodes(rig).hold(source, self.blocks)


@attrs.frozen
class Duplicate:
    """Second delivery of each of the next `count` messages of a topic."""

    topic: str
    count: int = 1

    def do(self, rig: RigDriver) -> None:
        """Deliver the next `count` messages of the topic twice."""
        with_nodes(rig).duplicate(self.topic, self.count)


@attrs.frozen
class Drop:
    """Loss of the next `count` messages of a topic at best-effort subscriptions.

    Reliable subscriptions still receive these messages.
    """

    topic: str
    count: int = 1

    def do(self, rig: RigDriver) -> None:
        """Drop the next `count` messages of the topic at subscriptions that are best effort."""
        with_nodes(rig).drop(self.topic, self.count)


@attrs.frozen
class SetParameter:
    """Change of a parameter of every node under test that has it.

    It is made after `after` further callbacks of all hosted nodes together; 0 is at once.
    """

    name: str
    value: object
    after: int = 0

    def do(self, rig: RigDriver) -> None:
        """Change the parameter in the nodes that have it, after `after` further callbacks of all hosted nodes."""
        with_nodes(rig).after(self.after, lambda: with_nodes(rig).set_parameter(self.name, self.value))


@attrs.frozen
class Send:
    """Message to the nodes under test, with the value `data` in its field `data`.

    If `data` is None, all fields of the message have their default values. It is sent after `after` further callbacks
    of all hosted nodes together; 0 is at once.
    """

    topic: str
    data: object
    after: int = 0

    def do(self, rig: RigDriver) -> None:
        """Send the message to the nodes after `after` further callbacks of all hosted nodes."""
        with_nodes(rig).after(self.after, lambda: with_nodes(rig).send_data(self.topic, self.data))


@attrs.frozen
class Call:
    """Call of a service, with an empty request, of every node under test that offers it.

    It is made after `after` further callbacks of all hosted nodes, counted from this action; 0 is at once.
    """

    service: str
    after: int = 0

    def do(self, rig: RigDriver) -> None:
        """Call the service of the nodes after `after` further callbacks of all hosted nodes; ignore its responses."""
        with_nodes(rig).after(self.after, lambda: with_nodes(rig).call(self.service))


RigAction = Command | ParameterChange | Inject | Pause | Silence
"""Action on any rig. If the rig rejects it, this is not a failure of the pipeline."""
Action = RigAction | Reset | LateJoin | Delay | First | Burst | Duplicate | Drop | SetParameter | Send | Call
"""Action on a rig, or on the transport between a `LocalRigWithNodes` and the nodes that it hosts.

Actions that are not a `RigAction` raise a TypeError for another rig, except `LateJoin`.
"""


def with_nodes(rig: RigDriver) -> LocalRigWithNodes:
    """Check that a rig is a `LocalRigWithNodes`, and return it.

    Raises:
        TypeError: the rig is not a `LocalRigWithNodes`.
    """
    from impact_rig.testing.schedule import LocalRigWithNodes  # noqa: PLC0415  # needs ROS

    if not isinstance(rig, LocalRigWithNodes):
        raise TypeError(f"this action needs a rig of the fixture virtual_rig_with_nodes, not {type(rig).__name__}")
    return rig


def schedules(
    topics: Sequence[str] = ("daq/scan", "daq/info", "shaker/applied"),
    parameters: Mapping[str, st.SearchStrategy[Any]] | None = None,
    messages: Mapping[str, st.SearchStrategy[Any]] | None = None,
    services: Sequence[str] = (),
    most_actions: int = 6,
    most_blocks: int = 8,
) -> st.SearchStrategy[list[Action]]:
    """Return a Hypothesis strategy for scenarios on a `LocalRigWithNodes`.

    A scenario has actions on the hosted nodes, on the transport and on the rig. It changes no parameter of the rig
    except the command timeout (`Silence`).

    Args:
        topics: topics that the nodes under test subscribe to, without a leading slash.
        parameters: strategies for the values of parameters of the nodes, by name of the parameter.
        messages: strategies for the field `data` of messages from other nodes, by name of the topic as in `topics`.
        services: names of services of the nodes; they are called with an empty request.
        most_actions: maximum number of actions, without the `LateJoin` with which a scenario may begin.
        most_blocks: maximum length of a `LateJoin` or of one disturbance of the transport; overlapping disturbances can
            last longer. Actions on the rig last up to `MOST_BLOCKS` blocks.
    """
    blocks, after = st.integers(1, most_blocks), st.integers(0, 6)
    inputs = (*topics, *(messages or {}))
    node_actions = [
        *(st.builds(SetParameter, st.just(name), value, after) for name, value in (parameters or {}).items()),
        *(st.builds(Send, st.just(topic), value, after) for topic, value in (messages or {}).items()),
        *(st.builds(Call, st.just(service), after) for service in services),
    ]
    transport = [
        st.builds(Burst, blocks),
        st.builds(Delay, st.sampled_from([*inputs, "timers", "messages"]), blocks),
        st.builds(First, st.sampled_from([*inputs, "timers"]), blocks),
        st.builds(Duplicate, st.sampled_from(inputs), st.integers(1, 3)),
        st.builds(Drop, st.sampled_from(inputs), st.integers(1, 3)),
    ]
    others = st.builds(Reset, after) | _rig_actions({})
    action: st.SearchStrategy[Action] = st.one_of(*3 * node_actions, *transport, others)  # half of them to the nodes
    late: st.SearchStrategy[list[Action]] = st.lists(st.builds(LateJoin, blocks), max_size=1)
    return st.builds(lambda begin, rest: [*begin, *rest], late, st.lists(action, max_size=most_actions))


def scenarios(
    changes: Mapping[str, st.SearchStrategy[float | bool]] | None = None, most_actions: int = 8
) -> st.SearchStrategy[list[RigAction]]:
    """Return a Hypothesis strategy for scenarios on any rig: lists of the actions in `RigAction`.

    Args:
        changes: strategies for the values of parameters of the rig, by name of the parameter; None means the gap only.
        most_actions: maximum number of actions.
    """
    gaps: Mapping[str, st.SearchStrategy[float | bool]] = {
        "barriers.gap_m": st.sampled_from([0.002, 0.004, 0.006, 0.010])
    }
    return st.lists(_rig_actions(gaps if changes is None else changes), max_size=most_actions)


def _rig_actions(values: Mapping[str, st.SearchStrategy[float | bool]]) -> st.SearchStrategy[RigAction]:
    blocks = st.integers(1, MOST_BLOCKS)
    of_channels = [(kind, name) for name, one in INSTRUMENTS.items() for kind in one.faults]
    sizes = st.sampled_from([1e-4, 1e-3, 1e-2])
    return st.one_of(
        st.builds(Pause, blocks),
        st.builds(
            Command, st.none() | st.sampled_from([8.5, 9.1, 10.0]), st.none() | st.sampled_from([0.0, 0.25, 0.52])
        ),
        st.builds(Inject, st.sampled_from(sorted(BOARD_KINDS)), st.just(""), blocks, sizes),
        st.sampled_from(of_channels).flatmap(
            lambda one: st.builds(Inject, st.just(one[0]), st.just(one[1]), blocks, sizes)
        ),
        st.builds(Silence, st.integers(2, MOST_BLOCKS)),
        *(st.builds(ParameterChange, st.just(key), value) for key, value in values.items()),
    )


Check = Callable[[RigDriver], Callable[[], object] | None]
"""Function that connects a pipeline to a rig, and returns a function with the final assertions, or None.

The pipeline may also raise AssertionError earlier, while the scenario is played.
"""


def repeat(rig: RigDriver, check: Check, actions: Sequence[Action]) -> None:
    """Play a scenario on a rig with the pipeline that `check` connects, then run the final assertions.

    `LateJoin` actions at the beginning are done before `check` is called. The rig advances by a block after each
    further action. An action that the rig rejects has no effect. At the end, disturbances of the transport end, and the
    rig advances until its faults are over (by at most `MOST_BLOCKS` blocks), and by `AFTERWARDS` further blocks.
    """
    rest = list(actions)
    while rest and isinstance(rest[0], LateJoin):
        rest.pop(0).do(rig)
    finish = check(rig)
    for action in rest:
        with contextlib.suppress(CommandError, ConfigError):
            action.do(rig)
        rig.step()
    if not all(isinstance(action, RigAction | LateJoin) for action in actions):
        with_nodes(rig).calm()
    lasting = max((fault.start_sample + fault.samples for fault in rig.faults), default=0) - rig.sample
    rig.step(min(max(0, -(-lasting // rig.block_scans)), MOST_BLOCKS) + AFTERWARDS)
    if finish is not None:
        finish()


def search(
    make_rig: Callable[..., RigDriver],
    check: Check,
    parameters: Mapping[str, object] | None = None,
    among: st.SearchStrategy[list[Action]] | None = None,
    examples: int = 100,
) -> None:
    """Play random scenarios on new rigs until one fails.

    The error of the shortest failing scenario is raised, with a note of the lines that repeat it. Each call plays the
    same scenarios. Call this function from a test with its fixture `virtual_rig`, `virtual_rig_with_nodes` or
    `ros_rig`: the failed test then keeps the recording of the shortest scenario.

    Args:
        make_rig: function that starts a rig with parameters: the fixture's value.
        check: function that connects the pipeline and checks it, see `Check`.
        parameters: parameters of every rig.
        among: strategy for the scenarios, such as `schedules()`; None means `scenarios()`.
        examples: maximum number of scenarios to play while none fails; the search for the shortest one plays more.
    """
    last: list[RigDriver] = []

    @seed(SEED)
    @settings(
        max_examples=examples,
        deadline=None,
        report_multiple_bugs=False,
        phases=(Phase.explicit, Phase.generate, Phase.shrink),
        print_blob=False,
    )
    @given(among if among is not None else scenarios())
    def played_and_checked(actions: list[Action]) -> None:
        while last:
            last.pop().close()
        last.append(make_rig(dict(parameters or {})))
        last[0].scenario = (
            f"from impact_rig.testing.strategies import *\nrig = {made}({dict(parameters or {})!r})\n"
            f"repeat(rig, {name}, {actions!r})\n"
        )
        repeat(last[0], check, actions)

    made, name = getattr(make_rig, "__name__", "make_rig"), getattr(check, "__name__", "check")
    try:
        played_and_checked()
    except BaseException as error:
        if last:
            lines = textwrap.indent(last[0].scenario.rstrip("\n"), "    ")
            error.add_note(f"the shortest scenario that fails; these lines repeat it:\n{lines}")
        raise
    while last:
        last.pop().close()
