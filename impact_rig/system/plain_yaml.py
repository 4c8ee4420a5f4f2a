# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Plain YAML from outside: values, never objects of Python, and a short text never stands for a long one.

An alias names one value in many places, or inside itself: whoever prints or copies what was read pays for all of them.
"""

from __future__ import annotations

from typing import Any  # PyYAML's nodes

import yaml
from yaml.composer import Composer

_Fastest: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml's scanner is fast; PyYAML may be built without
MAX_DEPTH = 100
"""libyaml's loader takes the stack for each level, and all of it ends the process."""


class PlainYamlError(ValueError):
    """A text is not YAML, nested too deeply, or more than plain YAML."""


def load(text: str, limit: int) -> object:
    """Return what a plain YAML text of at most `limit` characters holds.

    Raises:
        PlainYamlError: it is longer, no YAML, has an alias, a key twice, or is nested deeper than `MAX_DEPTH`.
    """
    if len(text) > limit:
        raise PlainYamlError(f"it has more than {limit} characters")
    try:
        return _content(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: a date that is none
        raise PlainYamlError(" ".join(str(error).split())) from error


class _Loader(Composer, _Fastest):  # type: ignore[misc]  # chosen at run time
    """Refuses, while it composes the nodes, what a plain text has not got: nothing is read twice."""

    def __init__(self, text: str) -> None:
        Composer.__init__(self)
        _Fastest.__init__(self, text)
        self._depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Return the next node."""
        if self.check_event(yaml.AliasEvent):
            raise PlainYamlError("an alias (*name) is not accepted")
        if self._depth >= MAX_DEPTH and self.check_event(yaml.SequenceStartEvent, yaml.MappingStartEvent):
            raise PlainYamlError(f"it is nested deeper than {MAX_DEPTH} levels")
        self._depth += 1
        node = Composer.compose_node(self, parent, index)
        self._depth -= 1
        if isinstance(node, yaml.MappingNode):
            _refuse_twice(node)
        return node


def _refuse_twice(mapping: yaml.MappingNode) -> None:
    """Refuse a key that is there twice: the later value would silently take the place of the first."""
    seen = set()
    for key, _ in mapping.value:
        if isinstance(key, yaml.ScalarNode):
            if (key.tag, key.value) in seen:
                raise PlainYamlError(f"the key {key.value!r} is there twice, again in line {key.start_mark.line + 1}")
            seen.add((key.tag, key.value))


def _content(text: str) -> object:
    loader = _Loader(text)
    try:
        content: object = loader.get_single_data()
    finally:
        loader.dispose()
    return content
