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
"""Readers for values in the file of a campaign, map or dynamics study, such as numbers, lists, ranges and gaps.

The argument `key` is the name of the value in error messages.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TypeVar

import attrs

from impact_rig.config.tree import Value, flatten
from impact_rig.errors import ConfigError
from impact_rig.names import yaml_quoted
from impact_rig.rig.config import RigConfig, from_flat, load_config
from impact_rig.rig.gaps import NO_SPHERE

S = TypeVar("S", bound=attrs.AttrsInstance)

MAX_VALUES = 10_000
HUGE = 10**30  # above every integer in a configuration; one of 400 digits is not a floating-point number
_DIGITS = 12  # digits of the values of a range, so that 9.00, 9.01, ... are exact


def wrong(key: str, rule: str, value: object) -> ConfigError:
    """Create the error "KEY must be RULE, got VALUE", for the caller to raise."""
    return ConfigError(f"{key} must be {rule}, got {yaml_quoted(value)}")


def check_keys(key: str, found: Mapping[str, object], known: Iterable[str]) -> None:
    """Check that a mapping in the file of a study contains only known keys.

    Args:
        key: key of the mapping itself, for the message; empty for the top level of the file.
        found: mapping to check.
        known: allowed keys.

    Raises:
        ConfigError: a key is unknown; the message names the first such key and all known ones.
    """
    names = list(known)
    for name in found:
        if name not in names:
            place = f" in {key}" if key else ""
            raise ConfigError(f"unknown key {name!r}{place}, known: {', '.join(names)}")


def number(key: str, value: object, low: float, high: float = math.inf) -> float:
    """Return a value that must be a finite number > low and <= high.

    Raises:
        ConfigError: the value is not a number (true and false are not), not finite, or out of range.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise wrong(key, "a number", value)
    if not (abs(value) < HUGE or isinstance(value, float)) or not (math.isfinite(value) and low < value <= high):
        above = "" if math.isinf(low) else f"> {low:g} and "
        raise wrong(key, f"{above}finite" if math.isinf(high) else f"{above}<= {high:g}", value)
    return float(value)


def whole(key: str, value: object, low: int, high: int) -> int:
    """Return a value that must be an integer >= low and <= high.

    Raises:
        ConfigError: the value is not an integer (3.0 and true are not), or is out of range.
    """
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise wrong(key, f"an integer >= {low} and <= {high}", value)
    return value


def word(key: str, value: object, choices: Iterable[str]) -> str:
    """Return a value that must be one of `choices`.

    Raises:
        ConfigError: the value is not one of `choices`.
    """
    allowed = list(choices)
    if value not in allowed:
        raise wrong(key, f"one of {', '.join(allowed)}", value)
    return str(value)


def words(key: str, value: object, choices: Iterable[str]) -> tuple[str, ...]:
    """Return the texts of a list, or a single text, as a tuple; each must be one of `choices`.

    Raises:
        ConfigError: a text is not one of `choices` or occurs twice, or there are none.
    """
    return tuple(word(key, item, choices) for item in values(key, value))


def mapping(key: str, value: object) -> dict[str, object]:
    """Return a value that must be a mapping with texts as keys; None (a key without a value) becomes an empty mapping.

    Raises:
        ConfigError: the value is not such a mapping.
    """
    if value is None:
        return {}
    if not isinstance(value, dict) or not all(isinstance(name, str) for name in value):
        raise wrong(key, "a mapping of names to values", value)
    return value


def values(key: str, value: object) -> list[object]:
    """Return the values of a list or range as a list; a single value becomes a list of length 1.

    A range is a mapping `{from: a, to: b, step: s}`. Its values ascend from `from`, and include `to` if that is a whole
    number of steps away.

    Raises:
        ConfigError: there are no or more than `MAX_VALUES` values, a value occurs twice or is itself a list or mapping,
            or the range is invalid.
    """
    items: list[object]
    if isinstance(value, dict):
        items = list(_range(key, value))
    elif isinstance(value, list):
        items = value
    else:
        items = [value]
    if not 1 <= len(items) <= MAX_VALUES:
        raise ConfigError(f"{key} must be a list of 1 to {MAX_VALUES} values, got {len(items)}")
    known: set[tuple[bool, object]] = set()
    for i, item in enumerate(items):
        if isinstance(item, (list, dict, set)):
            raise wrong(f"{key}[{i}]", "one value", item)
        same = isinstance(item, bool), item  # 1 and true are equal in Python
        if same in known:
            raise ConfigError(f"{key} must not repeat a value, got {yaml_quoted(item)} twice")
        known.add(same)
    return items


def numbers(key: str, value: object, low: float, high: float = math.inf) -> tuple[float, ...]:
    """Return the numbers of a list, a range or a single value; each must be > low and <= high.

    Lists and ranges are read by `values`.

    Raises:
        ConfigError: a value is not such a number, or the list or range is invalid.
    """
    return tuple(number(f"{key}[{i}]", item, low, high) for i, item in enumerate(values(key, value)))


def gaps(key: str, value: object) -> tuple[float, ...]:
    """Return the gaps [m] of a list, a range or a single value; each must be > 0 and <= 1 m.

    Lists and ranges are read by `values`. The text `none` and null (an empty value) become `NO_SPHERE`.

    Raises:
        ConfigError: a gap is not > 0 and <= 1 m, or the list is invalid.
    """
    found = tuple(
        NO_SPHERE if item in ("none", None) else number(f"{key}[{i}]", item, 0.0, 1.0)
        for i, item in enumerate(values(key, value))
    )
    if found.count(NO_SPHERE) > 1:
        raise ConfigError(f"{key} must not repeat a value, got 'none' and null, which both mean without the sphere")
    return found


def scalars(key: str, value: object) -> tuple[Value, ...]:
    """Return the numbers, texts or booleans of a list, a range or a single value.

    Lists and ranges are read by `values`. The rules of the rig's configuration are not checked.

    Raises:
        ConfigError: a value is of another type, or the list or range is invalid.
    """
    found: list[Value] = []
    for i, item in enumerate(values(key, value)):
        if not isinstance(item, (bool, int, float, str)):
            raise wrong(f"{key}[{i}]", "a number, a text, true or false", item)
        found.append(item)
    return tuple(found)


def rig(top: Mapping[str, object], folder: Path, refuse: Callable[[str, str], None]) -> RigConfig:
    """Return the rig that the file of a study defines by its keys `config` and `set`.

    `config` names a configuration file; without it, the rig is the default one. The values in `set` replace those of
    the configuration.

    Args:
        top: content of the file.
        folder: directory of the file, to which `config` is relative.
        refuse: function that receives the key `set.NAME` and the dotted name NAME of each value in `set`, and raises a
            ConfigError for a value that must not be set.

    Raises:
        ConfigError: a file cannot be read, a value is wrong, or `refuse` rejects one.
    """
    file = top.get("config")
    if file is not None and not isinstance(file, str):
        raise wrong("config", "the name of a file", file)
    changes = flatten(mapping("set", top.get("set")))
    for name in changes:
        refuse(f"set.{name}", name)
    return from_flat(load_config(folder / file) if file else RigConfig(), changes)


def settings(key: str, given: object, kind: type[S]) -> S:
    """Return an object of the class `kind` with settings from a file.

    `given` is the mapping under `key` in the file; None means an empty mapping. Missing settings have default values.

    Raises:
        ConfigError: a key or value is wrong.
    """
    wanted = mapping(key, given)
    check_keys(key, wanted, [attribute.name for attribute in attrs.fields(kind)])
    try:
        return kind(**wanted)
    except ConfigError as error:
        raise ConfigError(f"{key}.{error}") from error


def _range(key: str, given: Mapping[str, object]) -> Iterable[float]:
    check_keys(key, given, ("from", "to", "step"))
    missing = [name for name in ("from", "to", "step") if name not in given]
    if missing:
        raise ConfigError(f"{key} must have from, to and step; missing: {', '.join(missing)}")
    first, last = (number(f"{key}.{name}", given[name], -math.inf) for name in ("from", "to"))
    step = number(f"{key}.step", given["step"], 0.0)
    if last < first:
        raise wrong(f"{key}.to", f">= from = {first:g}", last)
    if not (last - first) / step < MAX_VALUES:
        raise wrong(f"{key}.step", f"such that there are at most {MAX_VALUES} values", step)
    count = math.floor((last - first) / step + 1e-9) + 1
    return (round(first + i * step, _DIGITS) + 0.0 for i in range(count))
