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
"""Stand-ins for the package launch, which comes with an apt-installed ROS only: they keep their arguments.

They accept the arguments that launch and launch_ros of Jazzy accept, as far as our files use them.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar

from impact_rig.system.files import share_dir


class Entity:
    """Action or substitution: the name of its class, and its arguments."""

    def __init__(self, *args: Any, **words: Any) -> None:
        self.args, self.words = args, words


class Context:
    """Context in which substitutions are performed: the arguments by name."""

    def __init__(self, arguments: Mapping[str, str], launch_configurations: Mapping[str, str] | None = None) -> None:
        self.arguments = arguments
        self.launch_configurations = launch_configurations or {}
        self.is_shutdown = False


class LaunchConfiguration(Entity):
    asked: ClassVar[set[str]] = set()

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.asked.add(name)

    def perform(self, context: Context) -> str:
        return context.arguments[self.args[0]]


class PathJoinSubstitution(Entity):
    def perform(self, context: Context) -> str:
        return "/".join(perform(part, context) for part in self.args[0])


class FindPackageShare(Entity):
    def perform(self, _context: Context) -> str:
        return str(share_dir())


class ParameterValue(Entity):
    def perform(self, context: Context) -> Any:
        text = perform(self.args[0], context)
        return text == "true" if self.words["value_type"] is bool else text


class DeclareLaunchArgument(Entity):
    pass


class GroupAction(Entity):
    pass


class IncludeLaunchDescription(Entity):
    pass


class LaunchDescription(Entity):
    pass


class Node(Entity):
    pass


class OpaqueFunction(Entity):
    pass


class PythonLaunchDescriptionSource(Entity):
    pass


class SetEnvironmentVariable(Entity):
    pass


class Shutdown(Entity):
    pass


MODULES: dict[str, tuple[type, ...]] = {
    "launch": (LaunchDescription,),
    "launch.actions": (
        DeclareLaunchArgument, GroupAction, IncludeLaunchDescription, OpaqueFunction, SetEnvironmentVariable, Shutdown,
    ),
    "launch.launch_description_sources": (PythonLaunchDescriptionSource,),
    "launch.substitutions": (LaunchConfiguration, PathJoinSubstitution),
    "launch_ros": (),
    "launch_ros.actions": (Node,),
    "launch_ros.parameter_descriptions": (ParameterValue,),
    "launch_ros.substitutions": (FindPackageShare,),
}  # fmt: skip


@contextmanager
def stand_ins() -> Iterator[None]:
    """Let `import launch` find the stand-ins."""
    before = {name: sys.modules.get(name) for name in MODULES}
    for name, classes in MODULES.items():
        module = ModuleType(name)
        for kind in classes:
            setattr(module, kind.__name__, kind)
        sys.modules[name] = module
    sys.modules["launch"].LaunchContext = Context  # type: ignore[attr-defined]  # a module made here
    try:
        yield
    finally:
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module


def description(path: Path) -> list[Entity]:
    """Return the entities of a launch file."""
    with stand_ins():
        spec = importlib.util.spec_from_file_location(path.stem.replace(".", "_"), path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        entities: list[Entity] = module.generate_launch_description().args[0]
    return entities


def perform(value: Any, context: Context) -> Any:
    """Return the value of a substitution, or a plain value itself."""
    if isinstance(value, dict):
        return {key: perform(inner, context) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(perform(inner, context) for inner in value)
    return value.perform(context) if hasattr(value, "perform") else value


def declared(entities: list[Entity]) -> dict[str, DeclareLaunchArgument]:
    """Return the declared arguments by name."""
    return {entity.args[0]: entity for entity in entities if isinstance(entity, DeclareLaunchArgument)}


def context_of(entities: list[Entity], arguments: Mapping[str, str]) -> Context:
    """Return the context with these arguments; one that is not declared, or not among the choices, is an error."""
    known = declared(entities)
    assert set(arguments) <= set(known), f"not declared: {set(arguments) - set(known)}"
    context = Context({})
    values = {name: perform(argument.words["default_value"], context) for name, argument in known.items()}
    values |= arguments
    for name, value in values.items():
        assert value in known[name].words.get("choices", [value]), name
    return Context(values)


def nodes(path: Path, pushed_namespace: str = "", **arguments: str) -> dict[str, dict[str, Any]]:
    """Return how each node would be started with these arguments, by name, below a pushed namespace."""
    entities = description(path)
    context = context_of(entities, arguments)
    context.launch_configurations = {"ros_namespace": pushed_namespace} if pushed_namespace else {}
    found: dict[str, dict[str, Any]] = {}
    with stand_ins():
        for entity in entities:
            if isinstance(entity, OpaqueFunction):
                found |= {
                    node.words["name"]: perform(node.words, context) for node in entity.words["function"](context)
                }
    return found


def used(path: Path) -> set[str]:
    """Return the arguments that a launch file uses."""
    LaunchConfiguration.asked.clear()
    nodes(path)
    return set(LaunchConfiguration.asked)
