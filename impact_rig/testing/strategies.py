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
"""Search for failures: scenarios of operator actions, parameter changes and faults, drawn by Hypothesis.

A scenario is a list of actions. Actions are data: they are drawn, shrunk, printed and played again. `search` plays many
scenarios on new rigs, each with the test's own `check`, and reports the shortest that fails, with three lines that
repeat it. Requires the extra `impact_rig[strategies]`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence

import attrs
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from impact_rig.driver import RigDriver
from impact_rig.errors import CommandError, ConfigError
from impact_rig.instruments.fault import Fault
from impact_rig.instruments.instrument import BOARD_KINDS
from impact_rig.instruments.registry import INSTRUMENTS

__all__ = ["Command", "Inject", "ParameterChange", "Pause", "Silence", "repeat", "scenarios", "search"]

AFTERWARDS = 3  # blocks after the last action, so that the pipeline sees its effect
MOST_BLOCKS = 20


@attrs.frozen
class Command:
    """Operator's command of frequency [Hz] and current [A]; None leaves a value unchanged."""

    frequency_hz: float | None = None
    current_a: float | None = None

    def do(self, rig: RigDriver) -> None:
        """Send the command."""
        rig.command(self.frequency_hz, self.current_a)


@attrs.frozen
class ParameterChange:
    """Change of a parameter."""

    key: str
    value: float | bool

    def do(self, rig: RigDriver) -> None:
        """Change the parameter."""
        rig.configure({self.key: self.value})


@attrs.frozen
class Inject:
    """Fault of the instruments that begins with the next scan and lasts this many blocks."""

    kind: str
    channel: str = ""
    blocks: int = 1
    value: float = 0.0

    def do(self, rig: RigDriver) -> None:
        """Inject the fault."""
        begin, length = rig.frontier_sample, self.blocks * rig.block_scans
        rig.inject(Fault(kind=self.kind, channel=self.channel, start_sample=begin, samples=length, value=self.value))


@attrs.frozen
class Pause:
    """Pause of this many blocks without any action."""

    blocks: int = 1

    def do(self, rig: RigDriver) -> None:
        """Advance by these blocks."""
        rig.step(self.blocks)


@attrs.frozen
class Silence:
    """Silence of the controller for this many blocks; the rig ramps down after half of them without a command."""

    blocks: int = 2

    def do(self, rig: RigDriver) -> None:
        """Advance without a command."""
        before = rig.config.output.command_timeout_s
        seconds = self.blocks * rig.block_scans / rig.rate_hz
        rig.configure({"output.command_timeout_s": 0.5 * seconds})
        rig.step(self.blocks)
        rig.configure({"output.command_timeout_s": before})


Action = Command | ParameterChange | Inject | Pause | Silence
"""Action on a rig. If the rig rejects it, this is not a failure of the pipeline."""


def scenarios(
    changes: Mapping[str, st.SearchStrategy[float | bool]] | None = None, most_actions: int = 8
) -> st.SearchStrategy[list[Action]]:
    """Return a strategy for scenarios.

    Args:
        changes: parameters that may be changed, and their values; None means the gap.
        most_actions: maximum number of actions.
    """
    blocks = st.integers(1, MOST_BLOCKS)
    values = changes if changes is not None else {"barriers.gap_m": st.sampled_from([0.002, 0.004, 0.006, 0.010])}
    of_channels = [(kind, name) for name, one in INSTRUMENTS.items() for kind in one.faults]
    sizes = st.sampled_from([1e-4, 1e-3, 1e-2])
    action: st.SearchStrategy[Action] = st.one_of(
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
    return st.lists(action, max_size=most_actions)


Check = Callable[[RigDriver], Callable[[], object] | None]
"""Function that connects a pipeline to a rig and returns the final assertion.

It may also raise AssertionError earlier.
"""


def repeat(rig: RigDriver, check: Check, actions: Sequence[Action]) -> None:
    """Play a scenario, a block after each action, under a check."""
    finish = check(rig)
    for action in actions:
        with contextlib.suppress(CommandError, ConfigError):
            action.do(rig)
        rig.step()
    rig.step(AFTERWARDS)
    if finish is not None:
        finish()


def search(
    make_rig: Callable[..., RigDriver],
    check: Check,
    parameters: Mapping[str, object] | None = None,
    among: st.SearchStrategy[list[Action]] | None = None,
    examples: int = 100,
) -> None:
    """Play scenarios until one fails; raise its error with the shortest failing scenario and how to repeat it.

    Call this from a test with its fixture `virtual_rig` or `ros_rig`: the failed test then keeps the recording of the
    shortest scenario.

    Args:
        make_rig: the fixture.
        check: check of the pipeline.
        parameters: parameters of every rig.
        among: scenarios; None means `scenarios()`.
        examples: maximum number of scenarios played.
    """
    last: list[RigDriver] = []
    played: list[list[Action]] = []

    @settings(
        max_examples=examples, deadline=None, database=None, derandomize=True, report_multiple_bugs=False,
        phases=(Phase.explicit, Phase.generate, Phase.shrink), print_blob=False,
    )  # fmt: skip
    @given(among if among is not None else scenarios())
    def played_and_checked(actions: list[Action]) -> None:
        while last:
            last.pop().close()
        played[:] = [actions]
        last.append(make_rig(dict(parameters or {})))
        repeat(last[0], check, actions)

    try:
        played_and_checked()
    except BaseException as error:
        made, name = getattr(make_rig, "__name__", "make_rig"), getattr(check, "__name__", "check")
        error.add_note(
            "the shortest scenario that fails; these lines repeat it:\n"
            "    from impact_rig.testing.strategies import *\n"
            f"    rig = {made}({dict(parameters or {})!r})\n"
            f"    repeat(rig, {name}, {played[0] if played else []!r})"
        )
        raise
    while last:
        last.pop().close()
