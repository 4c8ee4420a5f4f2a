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
"""Configuration fields with unit, range and origin, which reject invalid values with a message that names the field.

A section is a frozen attrs class whose fields are made by `quantity`, `quantities`, `choice`, `integer`, `switch`,
`names` or `text`. The metadata of each field contains what parameter descriptors, `docs/reference/interface.md` and
error messages need, so that nothing is written twice.
"""

from __future__ import annotations

import enum
import functools
import inspect
import math
import re
import textwrap
from collections.abc import Callable, Mapping
from typing import Any, TypeVar  # Any: attrs validators receive untyped instances

import attrs
import yaml

from impact_rig.errors import ConfigError
from impact_rig.names import yaml_quoted

S = TypeVar("S", bound="attrs.AttrsInstance")
METADATA_KEY = "impact_rig"
LONGEST_BITS = 64  # of an integer
LEAST, MOST = 1e-15, 1e15
"""Magnitudes allowed for every quantity that is not 0: a larger one is a mistake, and its products would overflow."""
_EXPONENT_FORM = re.compile(r"[-+]?[0-9]{1,20}(\.[0-9]{0,20})?[eE][-+]?[0-9]{1,3}")
_LIST_FORM = re.compile(r"\[[-+.0-9eE, ]{1,10000}\]")


class Origin(enum.Enum):
    """Origin of a default value.

    `PAPER`: the paper prints it. `IDENTIFIED`: it was chosen so that the statements of the paper hold. `ASSUMED`: it is
    a plausible catalogue value, or a choice of this project.
    """

    PAPER = "paper"
    IDENTIFIED = "identified"
    ASSUMED = "assumed"


@attrs.frozen
class FieldInfo:
    """Description of one configuration value: meaning, unit, allowed range, and origin of its default.

    Attributes:
        doc: meaning, in one sentence.
        unit: unit, such as `N/m` or `blocks`; `-` for none.
        origin: origin of the default.
        low: lower bound; None for none.
        high: upper bound; None for none.
        low_open: whether the value must be greater than `low`, not equal to it.
        high_open: whether the value must be less than `high`, not equal to it.
        choices: allowed words; empty for a value that is not a word.
        read_only: whether the value cannot change after the start of the rig or node that it configures.
        pattern: regular expression that a text must match completely; empty if any text is allowed.
        means: description, for messages, of the texts that `pattern` allows.
    """

    doc: str
    unit: str = "-"
    origin: Origin = Origin.ASSUMED
    low: float | None = None
    high: float | None = None
    low_open: bool = False
    high_open: bool = False
    choices: tuple[str, ...] = ()
    read_only: bool = False
    pattern: str = ""
    means: str = ""

    @property
    def unit_text(self) -> str:
        """The unit with a blank before it, as it follows a number; empty if there is none."""
        return "" if self.unit == "-" else f" {self.unit}"

    @property
    def meaning(self) -> str:
        """Meaning of the value as a part of a sentence: it begins in lower case and has no full stop."""
        return self.doc[:1].lower() + self.doc[1:].rstrip(".")

    def range_text(self) -> str:
        """Return the allowed numbers, words or texts, for messages: `> 0 and <= 1`, `one of sine, chirp`.

        The result has no meaning for a value that is true or false, or a list of texts.
        """
        if self.choices:
            return "one of " + ", ".join(self.choices)
        if self.means:
            return self.means
        parts = []
        if self.low is not None:
            parts.append(f"{'>' if self.low_open else '>='} {self.low:g}")
        if self.high is not None:
            parts.append(f"{'<' if self.high_open else '<='} {self.high:g}")
        return " and ".join(parts) or "any finite number"

    def allows(self, value: float) -> bool:
        """Return whether a number is finite and in the allowed range."""
        too_low = self.low is not None and (value < self.low or (self.low_open and value == self.low))
        too_high = self.high is not None and (value > self.high or (self.high_open and value == self.high))
        return math.isfinite(value) and not (too_low or too_high)


def info(attribute: attrs.Attribute[Any]) -> FieldInfo:
    """Return the description of a configuration value from its attrs attribute.

    The attribute must be made by a function of this module, such as `quantity`.
    """
    found = attribute.metadata[METADATA_KEY]
    assert isinstance(found, FieldInfo)
    return found


def describe_fields(section: type[S]) -> type[S]:
    """Decorate the class of a section: add meaning, range, unit and default of each field to its docstring."""
    lines = [inspect.cleandoc(section.__doc__ or ""), "", "Attributes:"]
    for attribute in attrs.fields(section):
        about = info(attribute)
        allowed = f"{about.range_text()}{about.unit_text}"
        text = f"{attribute.name}: {about.meaning} ({allowed}; default: {attribute.default})."
        lines += textwrap.wrap(text, 100, initial_indent="    ", subsequent_indent="        ")
    section.__doc__ = "\n".join(lines)
    return section


def _wrong(attribute: attrs.Attribute[Any], rule: str, value: object) -> ConfigError:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    unit = info(attribute).unit_text if is_number else ""
    return ConfigError(f"{attribute.name} must be {rule}, got {yaml_quoted(value)}{unit}")


def _in_range(attribute: attrs.Attribute[Any], value: float) -> None:
    about = info(attribute)
    if not about.allows(value):
        raise _wrong(attribute, about.range_text(), value)


def _check_float(_instance: object, attribute: attrs.Attribute[Any], value: object) -> None:
    if not isinstance(value, float):
        unit = info(attribute).unit_text
        raise _wrong(attribute, f"a number in{unit}" if unit else "a number", value)
    _in_range(attribute, value)
    if value and not LEAST <= abs(value) <= MOST:
        raise _wrong(attribute, f"0 or of a magnitude from {LEAST:g} to {MOST:g}", value)


def _check_int(_instance: object, attribute: attrs.Attribute[Any], value: object) -> None:
    if not isinstance(value, int) or isinstance(value, bool):
        raise _wrong(attribute, "an integer", value)
    if value.bit_length() > LONGEST_BITS:
        raise _wrong(attribute, info(attribute).range_text(), value)
    _in_range(attribute, value)


def _check_choice(_instance: object, attribute: attrs.Attribute[Any], value: object) -> None:
    about = info(attribute)
    if not isinstance(value, str) or value not in about.choices:
        raise _wrong(attribute, about.range_text(), value)


def _check_bool(_instance: object, attribute: attrs.Attribute[Any], value: object) -> None:
    if not isinstance(value, bool):
        raise _wrong(attribute, "true or false", value)


def _check_names(_instance: object, attribute: attrs.Attribute[Any], value: object) -> None:
    if not isinstance(value, tuple) or not all(isinstance(item, str) for item in value):
        raise _wrong(attribute, "a list of texts", value)


def _check_floats(_instance: object, attribute: attrs.Attribute[Any], value: object) -> None:
    if not isinstance(value, tuple) or not value or not all(isinstance(item, float) for item in value):
        raise _wrong(attribute, "one or more numbers", value)
    for item in value:
        _in_range(attribute, item)


def _to_float(value: object) -> object:
    """Convert an integer, or a text such as `8e-06`, to a float; return other values unchanged.

    Users write 6 for 6.0. YAML 1.1 reads 8e-06 as text because it has no point. The validator checks the result.
    """
    if isinstance(value, str) and _EXPONENT_FORM.fullmatch(value):
        return float(value)
    try:
        return float(value) if isinstance(value, int) and not isinstance(value, bool) else value
    except OverflowError:
        return math.inf


def _to_word(meant: Mapping[tuple[type, object], str], value: object) -> object:
    return meant.get((type(value), value), value) if isinstance(value, bool | str) else value


def _list_to_names(value: object) -> object:
    """Return a list of texts as a tuple without empty texts; return other values unchanged.

    ROS writes an empty list as `[""]`. Line ends within a text become blanks.
    """
    if not isinstance(value, (list, tuple)):
        return value
    return tuple(item.replace("\n", " ") if isinstance(item, str) else item for item in value if item != "")


def _list_to_floats(value: object) -> object:
    if isinstance(value, str) and _LIST_FORM.fullmatch(value):  # a list that mixes both forms of numbers is also text
        value = [_to_float(yaml.safe_load(item)) for item in value.strip("[]").split(",")]
    return tuple(_to_float(item) for item in value) if isinstance(value, (list, tuple)) else value


def _field(
    default: Any, about: FieldInfo, check: Callable[..., None], convert: Callable[[Any], object] | None = None
) -> Any:
    return attrs.field(default=default, converter=convert, validator=check, metadata={METADATA_KEY: about})


def quantity(
    default: float,
    unit: str,
    doc: str,
    origin: Origin = Origin.ASSUMED,
    *,
    above: float | None = None,
    at_least: float | None = None,
    below: float | None = None,
    at_most: float | None = None,
    read_only: bool = False,
) -> Any:
    """Return the attrs field of a finite float with unit and range.

    The bounds `above` and `below` are exclusive, `at_least` and `at_most` inclusive. In addition, a value other than 0
    must have a magnitude from `LEAST` to `MOST`. A `read_only` value cannot change after the start of the rig.
    """
    about = FieldInfo(
        doc,
        unit,
        origin,
        low=above if above is not None else at_least,
        high=below if below is not None else at_most,
        low_open=above is not None,
        high_open=below is not None,
        read_only=read_only,
    )
    return _field(default, about, _check_float, _to_float)


def quantities(
    default: tuple[float, ...], unit: str, doc: str, origin: Origin = Origin.ASSUMED, *, above: float, at_most: float
) -> Any:
    """Return the attrs field of a tuple of one or more finite floats, each > `above` and <= `at_most`, in one unit."""
    about = FieldInfo(doc, unit, origin, low=above, high=at_most, low_open=True)
    return _field(default, about, _check_floats, _list_to_floats)


def integer(
    default: int,
    unit: str,
    doc: str,
    *,
    at_least: int | None = None,
    at_most: int | None = None,
    read_only: bool = False,
) -> Any:
    """Return the attrs field of an integer with a unit.

    The bounds `at_least` and `at_most` are inclusive. The magnitude must be below 2**64.
    """
    about = FieldInfo(doc, unit, low=at_least, high=at_most, read_only=read_only)
    return _field(default, about, _check_int)


def choice(
    default: str,
    choices: tuple[str, ...],
    doc: str,
    origin: Origin = Origin.ASSUMED,
    *,
    read_only: bool = False,
    switched: Mapping[bool, str] | None = None,
    formerly: Mapping[str, str] | None = None,
) -> Any:
    """Return the attrs field of a word out of `choices`.

    `switched` maps true and false to words of `choices`. The field then also accepts true, false, `on` and `off`.
    `formerly` maps words of an earlier version, which recordings contain, to their present names. `choices` must not
    contain a word that YAML reads as another type, such as `on`; this is not checked.
    """
    meant: dict[tuple[type, object], str] = {(str, word): now for word, now in (formerly or {}).items()}
    for state, word in (switched or {}).items():
        meant[bool, state] = meant[str, "on" if state else "off"] = word
    about = FieldInfo(doc, "-", origin, choices=choices, read_only=read_only)
    return _field(default, about, _check_choice, functools.partial(_to_word, meant))


def switch(default: bool, doc: str, origin: Origin = Origin.ASSUMED, *, read_only: bool = False) -> Any:
    """Return the attrs field of a value that is true or false."""
    return _field(default, FieldInfo(doc, "-", origin, read_only=read_only), _check_bool)


def names(default: tuple[str, ...], doc: str) -> Any:
    """Return the attrs field of a tuple of any number of texts, such as names of nodes; empty texts are dropped."""
    return _field(default, FieldInfo(doc), _check_names, _list_to_names)


def _check_text(_instance: object, attribute: attrs.Attribute[Any], value: object) -> None:
    if not isinstance(value, str) or "\0" in value:
        raise _wrong(attribute, "a text", value)
    about = info(attribute)
    if about.pattern and not re.fullmatch(about.pattern, value):
        raise _wrong(attribute, about.means, value)


def _number_to_text(value: object) -> object:
    """Return a number as text, because YAML reads a name like 2026 as a number; return other values unchanged."""
    return str(value) if isinstance(value, int | float) and not isinstance(value, bool) else value


def text(default: str, doc: str, *, read_only: bool = False, pattern: str = "", means: str = "any text") -> Any:
    """Return the attrs field of a text, which must match `pattern` completely if given; `means` describes the pattern.

    A number is accepted as its text, because YAML reads a name like 2026 as a number.
    """
    about = FieldInfo(doc, read_only=read_only, pattern=pattern, means=means)
    return _field(default, about, _check_text, _number_to_text)
