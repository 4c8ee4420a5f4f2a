"""Plain YAML from outside: values, never objects of Python, and a short text never stands for a long one.

An alias names one value in many places, or inside itself: whoever prints or copies what was read pays for all of them.
"""

from __future__ import annotations

import yaml

_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml's is ten times faster; PyYAML may be built without
MAX_DEPTH = 100
"""libyaml's loader takes the stack for each level, and all of it ends the process."""


class PlainYamlError(ValueError):
    """A text is not YAML, nested too deeply, or more than plain YAML."""


def load(text: str, limit: int) -> object:
    """Return what a plain YAML text of at most `limit` characters holds.

    Raises:
        PlainYamlError: it is longer, is no YAML, names a value twice, or is nested deeper than `MAX_DEPTH`.
    """
    if len(text) > limit:
        raise PlainYamlError(f"it has more than {limit} characters")
    try:
        _check(text)
        return _content(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: a date that is none
        raise PlainYamlError(" ".join(str(error).split())) from error


def _check(text: str) -> None:
    depth = 0
    for event in yaml.parse(text, _Loader):
        if isinstance(event, yaml.AliasEvent):
            raise PlainYamlError("an alias (*name) is not accepted")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise PlainYamlError(f"it is nested deeper than {MAX_DEPTH} levels")


def _content(text: str) -> object:
    loader = _Loader(text)
    try:
        content: object = loader.get_single_data()
    finally:
        loader.dispose()
    return content
