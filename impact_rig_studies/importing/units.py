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
"""Conversion of units as instruments and programs print them.

The ordinary SI units, with prefixes, products and powers, need no library. All other units are looked up with `pint`
(extra `impact_rig[import]`). The quantities are those of this package: displacement, velocity, acceleration, current,
voltage, time and frequency.
"""

from __future__ import annotations

import functools
import math
import re
import unicodedata
from typing import NamedTuple

from impact_rig.errors import RecordingError

LONGEST_UNIT = 40
STANDARD_GRAVITY = 9.80665  # m/s^2


class _Size(NamedTuple):
    """Unit as a factor to SI and the exponents of metre, second, ampere and volt."""

    factor: float
    powers: tuple[int, int, int, int]


_METRE, _SECOND, _AMPERE, _VOLT = (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)
_GRAVITY = _Size(STANDARD_GRAVITY, (1, -2, 0, 0))
_BASE = {
    "m": _Size(1.0, _METRE),
    "s": _Size(1.0, _SECOND),
    "A": _Size(1.0, _AMPERE),
    "V": _Size(1.0, _VOLT),
    "Hz": _Size(1.0, (0, -1, 0, 0)),
}
_PREFIXES = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "d": 1e-1, "k": 1e3, "M": 1e6}
_INCH = 0.0254
_WORDS = {
    "metre": _BASE["m"], "meter": _BASE["m"], "millimetre": _Size(1e-3, _METRE), "millimeter": _Size(1e-3, _METRE),
    "centimetre": _Size(1e-2, _METRE), "centimeter": _Size(1e-2, _METRE),
    "micrometre": _Size(1e-6, _METRE), "micrometer": _Size(1e-6, _METRE), "mikrometer": _Size(1e-6, _METRE),
    "micron": _Size(1e-6, _METRE),
    "nanometre": _Size(1e-9, _METRE), "nanometer": _Size(1e-9, _METRE), "kilometre": _Size(1e3, _METRE),
    "kilometer": _Size(1e3, _METRE), "inch": _Size(_INCH, _METRE), "inches": _Size(_INCH, _METRE),
    "in": _Size(_INCH, _METRE), "ips": _Size(_INCH, (1, -1, 0, 0)), "mil": _Size(1e-3 * _INCH, _METRE),
    "thou": _Size(1e-3 * _INCH, _METRE),
    "foot": _Size(12.0 * _INCH, _METRE), "feet": _Size(12.0 * _INCH, _METRE), "ft": _Size(12.0 * _INCH, _METRE),
    "second": _BASE["s"], "sec": _BASE["s"], "sekunde": _BASE["s"], "sekunden": _BASE["s"], "sek": _BASE["s"],
    "seconde": _BASE["s"],
    "millisecond": _Size(1e-3, _SECOND), "msec": _Size(1e-3, _SECOND), "millisekunde": _Size(1e-3, _SECOND),
    "millisekunden": _Size(1e-3, _SECOND), "microsecond": _Size(1e-6, _SECOND), "usec": _Size(1e-6, _SECOND),
    "mikrosekunden": _Size(1e-6, _SECOND), "nanosecond": _Size(1e-9, _SECOND), "nsec": _Size(1e-9, _SECOND),
    "minute": _Size(60.0, _SECOND), "min": _Size(60.0, _SECOND), "hour": _Size(3600.0, _SECOND),
    "hr": _Size(3600.0, _SECOND), "h": _Size(3600.0, _SECOND), "day": _Size(86400.0, _SECOND),
    "hertz": _BASE["Hz"], "hz": _BASE["Hz"], "khz": _Size(1e3, (0, -1, 0, 0)), "mhz": _Size(1e6, (0, -1, 0, 0)),
    "ampere": _BASE["A"], "amp": _BASE["A"], "milliampere": _Size(1e-3, _AMPERE),
    "volt": _BASE["V"], "millivolt": _Size(1e-3, _VOLT),
    "м": _BASE["m"], "мм": _Size(1e-3, _METRE), "см": _Size(1e-2, _METRE), "мкм": _Size(1e-6, _METRE),
    "с": _BASE["s"], "сек": _BASE["s"], "мс": _Size(1e-3, _SECOND), "мкс": _Size(1e-6, _SECOND),
    "в": _BASE["V"], "мв": _Size(1e-3, _VOLT), "а": _BASE["A"], "гц": _BASE["Hz"],
    "g": _GRAVITY, "gn": _GRAVITY, "g0": _GRAVITY, "g_0": _GRAVITY, "g_n": _GRAVITY, "grav": _GRAVITY,
    "gravity": _GRAVITY,
    "standard_gravity": _GRAVITY, "gal": _Size(1e-2, (1, -2, 0, 0)), "mg": _Size(1e-3 * STANDARD_GRAVITY, (1, -2, 0,
    0)),
    "ug": _Size(1e-6 * STANDARD_GRAVITY, (1, -2, 0, 0)),
}  # fmt: skip
"""Units by word or abbreviation, in lower case; g and its variants are standard gravity, never gram."""
_CAPITALS = {
    "MM": _Size(1e-3, _METRE), "CM": _Size(1e-2, _METRE), "UM": _Size(1e-6, _METRE), "MS": _Size(1e-3, _SECOND),
    "M": _BASE["m"], "S": _BASE["s"], "MV": _Size(1e-3, _VOLT), "MA": _Size(1e-3, _AMPERE),
}  # fmt: skip
"""Units that some data loggers print in capitals."""
_OTHER_MEANING = ("H", "Mg", "MG", "In")  # henry, megagram; words of headings
_OTHER_UNITS = frozenset({
    "°", "deg", "degree", "degrees", "rad", "n", "kn", "pa", "kpa", "mpa", "bar", "psi", "%", "db", "k", "°c",
    "-", "w", "j", "kg", "nm", "lbf", "counts", "count", "raw", "n/a", "none", "a.u.", "arb", "µstrain", "v/v", "1",
    "dimensionless",
})  # fmt: skip
"""Units of other quantities, in lower case, by which a row of units in a table is recognised."""
_QUANTITIES = {
    "m": _METRE, "m/s": (1, -1, 0, 0), "m/s^2": (1, -2, 0, 0), "A": _AMPERE, "V": _VOLT, "s": _SECOND, "Hz": (0, -1,
    0, 0),
}  # fmt: skip
_ANGULAR = {
    "rad": 1.0 / (2.0 * math.pi), "deg": 1.0 / 360.0, "degree": 1.0 / 360.0, "°": 1.0 / 360.0, "rev": 1.0, "r": 1.0,
    "turn": 1.0, "u": 1.0, "1": 1.0,
}  # fmt: skip
"""Cycles per unit of an angle. Per unit of time they are frequencies; pint takes the radian as 1, not as 1/(2π)."""
_DOUBTFUL = {
    "G": "standard gravity (9.80665 m/s^2), not gauss",
    "Gs": "standard gravity (9.80665 m/s^2), not gauss",
    "gs": "standard gravity (9.80665 m/s^2), not gram seconds",
    "mG": "milli-gravity (0.00980665 m/s^2), not milligauss",
    "mg": "milli-gravity (0.00980665 m/s^2), not milligram",
}
_OPERATORS = str.maketrans({"·": "*", "⋅": "*", "×": "*", "µ": "u", "μ": "u", "\u2215": "/", "\u2212": "-"})
_SUPERSCRIPT = re.compile("[⁻⁰¹²³⁴]+")
_SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴", "-01234")
_STRANGE = re.compile(r"[^\w\s %/*^.()'\"-]|\d{3}|\d\s*(\*\*|\^)|__")
"""Pattern of characters that no unit has, and of powers of numbers, with which the parser of pint may never end."""
_FACTOR = re.compile(r"([*/]?)([^\W\d]+0?)(?:\^?(-?[1-9])|\^\((-?[1-9])\))?")


def unit_factor(unit: str, wanted: str) -> float | None:
    """Return the factor that converts values in `unit` to `wanted`; None if `unit` is unknown or of another quantity.

    A unit that this module does not know is looked up with `pint`.

    Raises:
        RecordingError: `pint` would have to look up the unit, but is not installed.
    """
    if unit == wanted:
        return 1.0
    if (cycles := _cycles_per_second(unit)) is not None:
        return cycles if wanted == "Hz" else None
    size = _parse(unit)
    if size is not None:
        target = _parse(wanted)
        if target is not None and target.powers == size.powers:
            return size.factor / target.factor
        return None
    return _by_pint(unit, wanted)


def quantity(unit: str) -> str | None:
    """Return the SI unit of the quantity that `unit` measures: m, m/s, m/s^2, A, V, s or Hz; None for other quantities.

    An angle per time, such as rad/s or rpm, is a frequency. A unit that only `pint` knows gives None if `pint` is not
    installed.
    """
    if _cycles_per_second(unit) is not None:
        return "Hz"
    size = _parse(unit)
    if size is not None:
        return next((name for name, powers in _QUANTITIES.items() if powers == size.powers), None)
    try:
        return next((name for name in _QUANTITIES if _by_pint(unit, name) is not None), None)
    except RecordingError:  # without pint it is not known
        return None


def is_unit(text: str) -> bool:
    """Return whether a cell of a table's heading is a unit of any quantity.

    Units that only `pint` knows do not count.
    """
    bare = _bare(text)
    bare = bare[1:-1].strip() if bare.startswith("(") and bare.endswith(")") else bare
    return _cycles_per_second(bare) is not None or _parse(bare) is not None or bare.lower() in _OTHER_UNITS


def doubt(unit: str) -> str:
    """Return, for the user, the assumed meaning of an ambiguous unit such as `G`; empty for other units."""
    return _DOUBTFUL.get(_bare(unit), "")


def _bare(unit: str) -> str:
    return unit.strip().strip("[]").strip()


def _cycles_per_second(unit: str) -> float | None:
    """Return the frequency [Hz] of one unit of an angle per time, such as `rad/s` or `rpm`; None for other units."""
    text = re.sub(r"\s*(?:\bper\b|/|\bpro\b)\s*", "/", _bare(unit).lower().replace("rpm", "rev/min"))
    angle, _, time = text.partition("/")
    if angle not in _ANGULAR or (size := _parse(time)) is None or size.powers != _SECOND:
        return None
    return _ANGULAR[angle] / size.factor


def _plain(unit: str) -> str:
    """Return a unit with its special characters replaced by ASCII, such as `m/s²` by `m/s^2` or `µm` by `um`."""
    raised = _SUPERSCRIPT.sub(lambda match: "^" + match[0].translate(_SUPERSCRIPTS), unit)
    return unicodedata.normalize("NFKC", raised).translate(_OPERATORS)


@functools.lru_cache(maxsize=1024)
def _parse(unit: str) -> _Size | None:
    """Return factor and exponents of a unit, which may have products and powers; None if it is unknown."""
    text = _bare(unit)
    if not text or len(text) > LONGEST_UNIT or _STRANGE.search(_plain(text)):
        return None
    if text == '"':
        return _WORDS["inch"]
    text = text.removesuffix(".") if len(text) > 2 else text  # in., sec.
    text = _plain(text).replace("**", "^").replace("'", "")
    text = re.sub(r"\s*(?:\bper\b|/|\bpro\b)\s*", "/", text)
    text = re.sub(r"(?i)\b(sec|second|s)/(?:sec|second|s)\b", r"\1^2", text)  # m/s/s
    text = re.sub(r"(?i)/\s*\(\s*s(?:ec)?\s*\*\s*s(?:ec)?\s*\)", "/s^2", text)
    text = re.sub(r"/\(([^()]*)\)", r"/\1", text) if "*" not in text else text
    if text.startswith("(") and text.endswith(")") and text.count("(") == 1:
        text = text[1:-1].strip()
    text = re.sub(r"\s*\.\s*|\s+", "*", text)
    text = re.sub(r"\*+(?=[*/])|(?<=[*/])\*+", "", text)
    factor, powers = 1.0, [0, 0, 0, 0]
    at = 0
    for match in _FACTOR.finditer(text):
        if match.start() != at or (at > 0) != bool(match[1]):
            return None
        at = match.end()
        one = _atom(match[2])
        if one is None:
            return None
        power = int(match[3] or match[4] or 1) * (-1 if match[1] == "/" else 1)
        factor *= one.factor**power
        powers = [total + power * each for total, each in zip(powers, one.powers, strict=True)]
    return _Size(factor, (powers[0], powers[1], powers[2], powers[3])) if at == len(text) and at else None


def _atom(word: str) -> _Size | None:
    """Return factor and exponents of a single unit without operators; None if it is unknown.

    SI units with a prefix take precedence over words. Words may be in the plural.
    """
    if word in _BASE:
        return _BASE[word]
    prefix, base = word[:1], word[1:]
    if base in _BASE and prefix in _PREFIXES:
        return _Size(_PREFIXES[prefix] * _BASE[base].factor, _BASE[base].powers)
    lower = word.lower()
    found = _WORDS.get(lower) or _WORDS.get(lower.removesuffix("s"))
    if found is not None and word not in _OTHER_MEANING:
        return found
    return _CAPITALS.get(word)


def _by_pint(unit: str, wanted: str) -> float | None:
    words = _plain(_bare(unit))
    if not words or len(words) > LONGEST_UNIT or _STRANGE.search(words):
        return None
    try:
        import pint  # noqa: PLC0415  # of an extra
    except ImportError as error:
        raise RecordingError(
            f"the unit {unit!r} is not known without pint; to convert it, install pint: pip install "
            "'impact_rig[import]'"
        ) from error
    registry = pint.application_registry
    try:
        factor = float(registry.Quantity(1.0, registry.parse_units(words)).to(wanted).magnitude)
    except Exception:  # pint raises what its parser, tokenizer and registry raise
        return None
    return factor if math.isfinite(factor) and factor != 0.0 else None


class Sensitivity(NamedTuple):
    """Sensitivity of a sensor: its output voltage per unit of the measured quantity."""

    volts: float  # volts per SI unit
    unit: str  # SI unit of the quantity

    @classmethod
    def parse(cls, text: str) -> Sensitivity | None:
        """Parse a sensitivity such as `500 mV/mm`, `10.2 mV/(m/s^2)` or `100 mV/g`.

        Returns None if the text is invalid or the sensitivity is zero. The sensitivity may be negative.

        Raises:
            RecordingError: `pint` would have to look up the unit of the voltage, but is not installed.
        """
        match = re.match(r"\s*([+-]?[\d.,]+(?:[eE][+-]?\d+)?)\s*([^/]{1,40})/(.{1,40})$", text)
        if match is None:
            return None
        try:
            number = float(match[1].replace(",", "."))
        except ValueError:
            return None
        below = match[3].strip()
        below = below[1:-1] if below.startswith("(") and below.endswith(")") else below
        volts, target = unit_factor(match[2].strip(), "V"), quantity(below)
        if volts is None or target is None or not math.isfinite(number) or number == 0.0:
            return None
        factor = unit_factor(below, target)
        return cls(number * volts / factor, target) if factor else None
