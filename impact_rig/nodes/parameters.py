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
"""ROS parameters derived from configuration fields, with one validator for start-up files and run-time changes.

Every change passes the validator of `impact_rig.config`, so a bad value gives the same message at start and at run
time. The descriptors of the parameters show unit and range in ROS tools.
"""

from __future__ import annotations

import array
import itertools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Generic, TypeVar  # Any: rclpy messages

import attrs
import yaml
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from impact_rig.config import FieldInfo
from impact_rig.config.tree import Tree, Value
from impact_rig.errors import ConfigError, describe
from impact_rig.nodes.rclpy_internals import parameter_overrides

S = TypeVar("S", bound=attrs.AttrsInstance)
Attempt = Callable[[list[Parameter]], SetParametersResult]  # sets some parameters together

_LARGEST = 1.7976931348623157e308
_LARGEST_INTEGER = 2**63 - 1
CONFIG_FILE = "config_file"  # parameter: a configuration file to start from; other parameters override it
SIM_TIME = "use_sim_time"
FOREIGN = (SIM_TIME, "start_type_description_service", "qos_overrides.")  # overrides that belong to rclpy
NO_SIM_TIME = "must be false for this node, which publishes the clock"


@attrs.frozen
class Proposal(Generic[S]):
    """Change of parameters that the validator has accepted and that is not applied yet.

    Attributes:
        stored: the requested parameters as ROS will store them, without those that `Parameters.check` ignores. Their
            values may equal the present ones.
        settings: all parameters of the node after the change, as one object.
        changes: only the values that differ from the present ones, by name.
    """

    stored: list[Parameter]
    settings: S
    changes: dict[str, Value]


class Parameters(Generic[S]):
    """Parameters of one node, declared from a tree of settings and changed only through its validator.

    Args:
        node: node that owns the parameters; its `set_parameters_atomically` calls `check` first.
        tree: names, descriptions and validator of the parameters.
        arguments: command line of the process; errors of start-up values name the parameter files in it.
        makes_time: whether the node publishes the clock, so that `use_sim_time` must stay false.
        complete: function that returns the start-up settings with values that only the node knows.
    """

    def __init__(
        self,
        node: Node,
        tree: Tree[S],
        arguments: Iterable[str] = (),
        makes_time: bool = False,
        complete: Callable[[S], S] = lambda settings: settings,
    ) -> None:
        self._makes_time = makes_time
        self._node = node
        self._tree = tree
        self._infos = {name: about for name, about, _ in tree.fields()}
        self.refused: ConfigError | None = None
        """Error that rejected the start-up values, or None; after an error, the settings are the defaults."""
        given = parameter_overrides(node)
        self.settings = self._at_start(given, _files(arguments), complete)
        if makes_time and given.get(SIM_TIME) is True:
            self.refused = ConfigError(f"{SIM_TIME} {NO_SIM_TIME}")
        for name, value in tree.to_flat(self.settings).items():
            found = descriptor(self._infos[name], value)
            node.declare_parameter(name, _to_ros(value), found, ignore_override=True)
        about = ParameterDescriptor(
            description="Configuration file with start-up values; other parameters override it.", read_only=True
        )
        node.declare_parameter(CONFIG_FILE, str(given.get(CONFIG_FILE, "")), about, ignore_override=True)

    def _at_start(self, given: Mapping[str, object], files: str, complete: Callable[[S], S]) -> S:
        ours = {name: _from_ros(value) for name, value in given.items() if not name.startswith(FOREIGN)}
        try:
            path = ours.pop(CONFIG_FILE, "")
            base = self._tree.load(str(path)) if path else self._tree.root()
            return complete(self._tree.from_flat(base, ours))
        except ConfigError as error:
            self.refused = ConfigError(f"{error}{files}")
            return self._tree.root()

    def check(self, wanted: list[Parameter]) -> Proposal[S]:
        """Validate a change of these parameters, and return it as a `Proposal`; nothing is changed.

        A read-only or text parameter that would keep its value is ignored, so that `ros2 param load` accepts a complete
        dump. Parameters of rclpy (`FOREIGN`) are not validated, except `use_sim_time`.

        Raises:
            ConfigError: a name is unknown, a read-only parameter would change, a value is invalid, or values contradict
                each other. Or `use_sim_time` would be true in a node that publishes the clock.
        """
        changes: dict[str, object] = {}
        wanted = [parameter for parameter in wanted if not self._unchanged(parameter)]
        for parameter in wanted:
            if self._makes_time and parameter.name == SIM_TIME and parameter.value is True:
                raise ConfigError(f"{SIM_TIME} {NO_SIM_TIME}")
            if not parameter.name.startswith(FOREIGN):
                changes[parameter.name] = _from_ros(parameter.value)
        settings = self._tree.from_flat(self.settings, changes)
        values = self._tree.to_flat(settings)
        stored = [
            Parameter(p.name, value=_to_ros(values[p.name])) if p.name in changes and values[p.name] != () else p
            for p in wanted
        ]
        return Proposal(stored, settings, self._tree.differences(settings, self.settings))

    def _unchanged(self, parameter: Parameter) -> bool:
        """Return whether a request can be ignored, because a read-only or text parameter would keep its value.

        The value also counts as kept if it is the present value as `ros2 param load` sends it (see `_as_loaded`).

        Raises:
            ConfigError: a read-only parameter would change.
        """
        if not self._node.has_parameter(parameter.name):
            return False  # the tree, or rclpy, rejects it by name
        given, present = _from_ros(parameter.value), _from_ros(self._node.get_parameter(parameter.name).value)
        loaded = _as_loaded(present)
        same = given == present or (type(given) is type(loaded) and given == loaded)
        fixed = self._node.describe_parameter(parameter.name).read_only
        if fixed and not same:
            raise ConfigError(f"{parameter.name} is read-only: set it when the node starts (parameter file or -p)")
        return same and (fixed or isinstance(present, str))


def set_one_by_one(messages: list[Any], attempt: Attempt) -> list[SetParametersResult]:
    """Set parameters one by one, as ROS does, and return one result for each message, in the given order.

    A rejected parameter is tried again after another parameter has been accepted. A value may therefore precede the
    value that makes it valid.

    Args:
        messages: parameters as ROS messages.
        attempt: validates and sets some parameters together; may be called repeatedly for the same parameter.
    """
    results: list[SetParametersResult] = []
    refused: dict[int, Parameter] = {}
    for number, message in enumerate(messages):
        try:
            parameter = Parameter.from_parameter_msg(message)
        except Exception as error:  # rclpy raises for an unknown type
            results.append(SetParametersResult(successful=False, reason=describe(error)))
            continue
        results.append(attempt([parameter]))
        if not results[number].successful:
            refused[number] = parameter
    progress = any(result.successful for result in results)
    while refused and progress:
        again = {number: attempt([parameter]) for number, parameter in refused.items()}
        progress = any(result.successful for result in again.values())
        for number, result in again.items():
            results[number] = result
            if result.successful:
                del refused[number]
    return results


def descriptor(about: FieldInfo, value: Value) -> ParameterDescriptor:
    """Return the ROS descriptor of a parameter: description, unit, range and whether it is read-only.

    Ranges of ROS include their limits. If a limit itself is not allowed, the text of the descriptor says so, and the
    validator rejects the limit.

    Args:
        about: configuration field of the parameter.
        value: present value, which decides the ROS type.
    """
    unit = "" if about.unit == "-" else f" [{about.unit}]"
    limited = bool(about.choices) or about.low is not None or about.high is not None
    found = ParameterDescriptor(
        description=f"{about.doc}{unit}",
        read_only=about.read_only,
        additional_constraints=about.range_text() if limited else "",
    )
    if isinstance(value, tuple):
        kind = Parameter.Type.DOUBLE_ARRAY if value and isinstance(value[0], float) else Parameter.Type.STRING_ARRAY
        found.type = kind.value  # rclpy takes an empty list for bytes
    if about.low is None and about.high is None:
        return found
    if isinstance(value, int):
        low = -_LARGEST_INTEGER if about.low is None else int(about.low)
        high = _LARGEST_INTEGER if about.high is None else int(about.high)
        found.integer_range = [IntegerRange(from_value=low, to_value=high, step=0)]
    else:
        least = -_LARGEST if about.low is None else float(about.low)
        most = _LARGEST if about.high is None else float(about.high)
        found.floating_point_range = [FloatingPointRange(from_value=least, to_value=most, step=0.0)]
    return found


def _to_ros(value: Value) -> object:
    """Return a configuration value as a ROS parameter value; an empty list becomes `[""]`, as ROS cannot type it."""
    return (list(value) or [""]) if isinstance(value, tuple) else value


def _from_ros(value: object) -> object:
    return tuple(value) if isinstance(value, (list, array.array)) else value


def _as_loaded(value: object) -> object:
    """Return the value that `ros2 param load` sends after `ros2 param dump` has written `value` to a file.

    The two values can differ, because `ros2 param load` parses a text as YAML again: the text `1` becomes a number.
    """
    try:
        loaded = yaml.safe_load(str(value))
    except yaml.YAMLError:
        return value
    return str(value) if loaded is None else loaded


def _files(arguments: Iterable[str]) -> str:
    words = list(arguments)
    files = [after for word, after in itertools.pairwise(words) if word == "--params-file"]
    return f" ({', '.join(files)})" if files else ""
