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
"""Reader and writer of configurations as trees of sections: YAML files, ROS parameters, mappings, with one validator.

A configuration file is a ROS 2 parameter file (`/**: ros__parameters: section: key: value`), so the same file works
with `--ros-args --params-file`; the two outer keys may be left out. A parameter's name is `section.key`, e.g.
`barriers.gap_m`.
"""

from __future__ import annotations

import functools
import operator
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Generic, TypeVar  # Any: what a mapping within another holds

import attrs
import yaml

from impact_rig.config.fields import METADATA_KEY, FieldInfo, info
from impact_rig.errors import ConfigError, did_you_mean
from impact_rig.names import quoted
from impact_rig.system import budget, files

MAX_FILE_BYTES = 1_000_000
MAX_KEYS = 2000
MAX_DEPTH = 20

Value = bool | int | float | str | tuple[str, ...]
Root = TypeVar("Root", bound=attrs.AttrsInstance)
N = TypeVar("N", bound="dict[str, Any]")


class Tree(Generic[Root]):
    """Reader and writer of configurations of one kind: the attrs class `root`, whose fields are values or sections."""

    def __init__(self, root: type[Root]) -> None:
        self.root = root

    @functools.cached_property
    def _known(self) -> dict[str, FieldInfo]:
        """Unit, range and meaning of each configuration value, by dotted name, in the order of the fields."""
        return dict(_walk(self.root, ""))

    def load(self, path: Path | str, overrides: Mapping[str, object] | None = None) -> Root:
        """Return the configuration in a YAML file; a value that is not in the file has its default.

        Args:
            path: the file.
            overrides: values by dotted name (`section.key`) that replace those of the file.

        Raises:
            ConfigError: the file cannot be read, is not plain YAML, contains an unknown key or an invalid value, or its
                values contradict each other. The message names the file, and for an invalid value its key and range.
        """
        path = Path(path)
        try:
            content = files.read_bytes(path, MAX_FILE_BYTES)
        except OSError as error:
            raise ConfigError(f"cannot read configuration: {files.reason_unreadable(error, path)}") from error
        try:
            return self.parse(content, overrides)
        except ConfigError as error:
            raise ConfigError(f"{error} ({path})") from error

    def parse(self, content: bytes, overrides: Mapping[str, object] | None = None) -> Root:
        """Return the configuration in the content of a YAML file; arguments and defaults are as in `load`.

        Raises:
            ConfigError: as `load`; the message names no file.
        """
        try:
            text = str(content, "utf-8")
        except UnicodeDecodeError as error:
            line = content.count(b"\n", 0, error.start) + 1
            raise ConfigError(
                f"cannot be read as plain YAML: it must be UTF-8 text, got byte 0x{content[error.start]:02x} in line "
                f"{line}; save it as UTF-8"
            ) from error
        return self.from_flat(self.root(), {**parameters_in(text), **(overrides or {})})

    def from_flat(self, base: Root, changes: Mapping[str, object]) -> Root:
        """Return a copy of `base` with `changes`: new values by dotted name (`section.key`).

        Raises:
            ConfigError: a key is unknown, a value is invalid, or the resulting values contradict each other.
        """
        for name in changes:
            if name not in self._known:
                groups = dict.fromkeys(re.sub(r"\..*", ".*", known) for known in self._known)
                hint = did_you_mean(name, self._known, ", did you mean {!r}?", f", known: {', '.join(groups)}")
                raise ConfigError(f"unknown key {quoted(name)}{hint}")
        changed = _evolve(base, nested(changes, _Nested))
        assert isinstance(changed, self.root)
        return changed

    def to_flat(self, config: Root) -> dict[str, Value]:
        """Return every value of `config` by its dotted name, which is also the name of the node's parameter."""
        return {name: operator.attrgetter(name)(config) for name in self._known}

    def differences(self, config: Root, before: Root | None = None) -> dict[str, Value]:
        """Return the values of `config` that differ from `before` (None: the default), by dotted name."""
        old = self._defaults if before is None else self.to_flat(before)
        return {name: value for name, value in self.to_flat(config).items() if value != old[name]}

    @functools.cached_property
    def _defaults(self) -> dict[str, Value]:
        return self.to_flat(self.root())

    def fields(self) -> Iterator[tuple[str, FieldInfo, Value]]:
        """Yield (dotted name, `FieldInfo`, default) of every configuration value, in the order of the fields."""
        for name, about in self._known.items():
            yield name, about, self._defaults[name]

    def dump(self, config: Root) -> str:
        """Return the text of a ROS 2 parameter file with all values of `config`, which `load` reads unchanged."""
        plain = {  # ROS has no empty typed lists
            name: list(value or ("",)) if isinstance(value, tuple) else value
            for name, value in self.to_flat(config).items()
        }
        text: str = yaml.safe_dump({"/**": {"ros__parameters": nested(plain, dict)}}, sort_keys=False)
        return text


def parameters_in(text: str) -> dict[str, object]:
    """Return the values in the text of a configuration file, by dotted name, as written there and unchecked.

    The names do not contain the two outer keys of a ROS 2 parameter file. An empty text has no values.

    Raises:
        ConfigError: the text is not plain YAML (`budget.load_yaml`), or not a mapping of sections.
    """
    try:
        document = budget.load_yaml(text, MAX_FILE_BYTES)
    except budget.PlainYamlError as error:
        raise ConfigError(f"cannot be read as plain YAML: {error}") from error
    return flatten(_unwrap(document))


def flatten(tree: object, prefix: str = "", depth: int = 0) -> dict[str, object]:
    """Return the values of nested mappings by their dotted names; an empty inner mapping counts as a value.

    Args:
        tree: the outermost mapping.
        prefix: names of the mappings around `tree`, each with a dot; set by the recursion.
        depth: number of these mappings; set by the recursion.

    Raises:
        ConfigError: a key is not a text, `tree` is not a mapping, or there are too many keys or levels.
    """
    if depth > MAX_DEPTH:
        raise ConfigError(
            f"section {quoted(prefix.removesuffix('.'))} is nested too deep: at most {MAX_DEPTH} levels are allowed"
        )
    if not isinstance(tree, dict):
        got = "a list" if isinstance(tree, list) else "a single value"
        raise ConfigError(f"a configuration must be a mapping of sections, got {got}")
    flat: dict[str, object] = {}
    for key, value in tree.items():
        if not isinstance(key, str):
            where = f" in {quoted(prefix.removesuffix('.'))}" if prefix else ""
            raise ConfigError(f"a key must be a text, got {quoted(key)}{where}")
        name = f"{prefix}{key}"
        if isinstance(value, dict) and value:
            flat.update(flatten(value, f"{name}.", depth + 1))
        else:
            flat[name] = value
        if len(flat) > MAX_KEYS:
            raise ConfigError(f"too many values: at most {MAX_KEYS} are allowed in a configuration")
    return flat


def nested(flat: Mapping[str, object], kind: type[N]) -> N:
    """Return values by dotted name as nested new mappings of class `kind`: `{"a.b": 1}` becomes `{"a": {"b": 1}}`."""
    tree = kind()
    for name, value in flat.items():
        *sections, key = name.split(".")
        node = tree
        for section in sections:
            node = node.setdefault(section, kind())
        node[key] = value
    return tree


def _unwrap(document: object) -> object:
    if document is None:
        return {}
    if isinstance(document, dict) and len(document) == 1:
        inner = next(iter(document.values()))
        if isinstance(inner, dict) and set(inner) == {"ros__parameters"}:
            return inner["ros__parameters"] or {}
    return document


def _walk(section: type[attrs.AttrsInstance], prefix: str) -> Iterator[tuple[str, FieldInfo]]:
    for attribute in attrs.fields(attrs.resolve_types(section)):
        name = f"{prefix}{attribute.name}"
        if METADATA_KEY in attribute.metadata:
            yield name, info(attribute)
        else:
            assert isinstance(attribute.type, type)
            yield from _walk(attribute.type, f"{name}.")


def _evolve(section: attrs.AttrsInstance, changes: Mapping[str, object], prefix: str = "") -> attrs.AttrsInstance:
    """Return a copy of `section` with the nested `changes`, whose keys must exist.

    Checks across several values see only the final combination. `prefix` is the section's dotted name with a dot at the
    end, for messages.

    Raises:
        ConfigError: a value is invalid, or values contradict each other.
    """
    values = {
        key: _evolve(getattr(section, key), value, f"{prefix}{key}.") if isinstance(value, _Nested) else value
        for key, value in changes.items()
    }
    try:
        return attrs.evolve(section, **values)  # type: ignore[misc]  # mypy's plugin wants one concrete attrs class
    except ConfigError as error:
        raise ConfigError(f"{prefix}{error}") from error


class _Nested(dict[str, object]):
    """Changes within a sub-section, by key; the class distinguishes them from a value that is a mapping."""
