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
"""Parsers of quantities on the command line, which are numbers with a unit."""

from __future__ import annotations

import argparse
import re
import unicodedata
from collections.abc import Mapping
from decimal import Decimal
from typing import Any  # attrs fields of any section

import attrs

from impact_rig.config import fields
from impact_rig.config.fields import FieldInfo
from impact_rig.config.sections import Barriers
from impact_rig.errors import ConfigError

LENGTH = "m"
NO_SPHERE_WORD = "none"
POWERS: Mapping[str, Mapping[str, int]] = {
    LENGTH: {"m": 0, "cm": -2, "mm": -3, "um": -6, "μm": -6, "nm": -9},
    "Hz": {"Hz": 0, "mHz": -3, "kHz": 3},
    "A": {"A": 0, "mA": -3},
    "s": {"s": 0, "ms": -3},
    "m/s²": {"m/s2": 0},
}
"""Power of ten of each allowed unit, by the SI unit of the option; other options accept only their own unit."""
_FORM = re.compile(r"([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]{1,3})?)\s*([^\s0-9.,][^\s]*)?")


@attrs.frozen(eq=False)
class Quantity:
    """Parser of a quantity with its unit, for `type=` of an option.

    A length must have a unit, because people who write 6 usually mean 6 mm, and not 6 m. Any other quantity may be
    written without one; it is then in the SI unit.

    Attributes:
        about: unit and allowed range of the value.
        words: values of special texts, such as 0 for `none`.
        names: whether a text that is not a quantity is accepted as the name of a signal, and returned unchanged.
    """

    about: FieldInfo
    words: Mapping[str, float] = attrs.field(factory=dict)
    names: bool = False

    @classmethod
    def of(cls, field: attrs.Attribute[Any], words: Mapping[str, float] | None = None) -> Quantity:
        """Return the parser for a field of the configuration, with the field's unit and range.

        `words` are the values of special texts, such as 0 for `none`.
        """
        return cls(fields.info(field), words or {})

    def __call__(self, text: str) -> float | str:
        """Return the value of an option's text in the SI unit.

        Raises:
            argparse.ArgumentTypeError: the text is invalid (see `parse`); argparse adds the option's name to the
                message.
        """
        try:
            return self.parse(text)
        except ConfigError as error:
            raise argparse.ArgumentTypeError(str(error)) from error

    def parse(self, text: str) -> float | str:
        """Return the value of `text` in the SI unit, or the value of a word in `words`.

        `6mm` gives exactly the number 0.006. Only a length needs its unit. If `names` is true, any other text is
        returned unchanged, as the name of a signal. This includes a number with a unit that is not allowed.

        Raises:
            ConfigError: the text is neither a word nor a number in the allowed range, or its unit is missing or not
                allowed; the message names no option.
        """
        if text in self.words:
            return self.words[text]
        unit = self.about.unit
        powers = POWERS.get(unit, {unit: 0} if self.about.unit_text else {})
        match = _FORM.fullmatch(unicodedata.normalize("NFKC", text.strip()))
        number, written = match.groups() if match else ("", None)
        if self.names and (not match or (written and written not in powers)):
            return text
        if not match or (written and not powers):
            raise ConfigError(f"must be a number{self._with_unit()}, got {text!r}")
        if written is None and unit == LENGTH:
            raise ConfigError(
                f"a length needs a unit after the number, e.g. 6mm or 0.006m{self._or_words()}, got {text!r}"
            )
        if written is not None and written not in powers:
            raise ConfigError(f"the unit must be one of {', '.join(powers)}, got {text!r}")
        value = float(Decimal(number).scaleb(powers[written] if written else 0))
        if not self.about.allows(value):
            raise ConfigError(f"must be {self.about.range_text()}{self.about.unit_text}, got {text!r}")
        return value

    def number(self, text: str) -> float:
        """Return the value of `text` like `parse`, but always as a number.

        `names` must be false, so that the parser accepts no names of signals.

        Raises:
            ConfigError: as `parse`.
        """
        value = self.parse(text)
        assert not isinstance(value, str)
        return value

    def _with_unit(self) -> str:
        if self.about.unit == LENGTH:
            return f" with its unit, e.g. 6mm{self._or_words()}"
        return f"{' in' if self.about.unit_text else ' without a unit'}{self.about.unit_text}{self._or_words()}"

    def _or_words(self) -> str:
        return "".join(f", or the word {word}" for word in self.words)


def positive(unit: str) -> Quantity:
    """Return a parser of quantities above zero in `unit`, for `type=` of an option."""
    return Quantity(FieldInfo("", unit, low=0.0, low_open=True))


def add_field(
    parser: argparse.ArgumentParser, field: attrs.Attribute[Any], metavar: str | None = None, option: str = ""
) -> None:
    """Add an option that sets a field of a configuration or plan.

    Default, unit, range and help text come from the field. The parser does not check the range of an integer; the
    configuration or plan does.

    Args:
        parser: parser of a command.
        field: the field, made by `config.fields`.
        metavar: placeholder of its value in the help; None lets argparse list the words of a choice.
        option: name of the option, with its dashes (default: that of the field).
    """
    about = fields.info(field)
    default: Any = field.default
    several = isinstance(default, tuple)
    shown = " ".join(f"{one:g}" for one in default) if several else default
    kind: dict[str, Any] = {"type": int} if isinstance(default, int) else {"type": Quantity.of(field)}
    if about.choices:
        kind = {"choices": about.choices}
    if several:
        kind["nargs"] = "+"
    parser.add_argument(
        option or f"--{field.name.replace('_', '-')}",
        default=default,
        metavar=metavar,
        help=f"{about.meaning} (default: {shown})",
        **kind,
    )


GAP = Quantity.of(attrs.fields(Barriers).gap_m, {NO_SPHERE_WORD: 0.0})
"""Parser of a gap between the barriers, a length with its unit; `none` means no sphere and gives 0."""
