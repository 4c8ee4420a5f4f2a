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
"""Assignment of a file's signals to the channels of a rig: guessed from names and units, or stated by `--channel`."""

from __future__ import annotations

import re
from collections.abc import Mapping as AnyMapping
from collections.abc import Sequence

import attrs

from impact_rig.analysis.scans import CHANNELS
from impact_rig.errors import ConfigError
from impact_rig_studies.importing import file_names
from impact_rig_studies.importing.mapping import UNITS, Channel, Mapping
from impact_rig_studies.importing.signals import ImportedSignals, Signal, SignalKind
from impact_rig_studies.importing.units import quantity

HINTS = {
    "accelerometer": ("accelerometer", "acceleration", "beschleunigung", "accel", "acc", "a_1", "a1"),
    "laser": (
        "laser", "structure", "struktur", "superior", "response", "antwort", "top", "oben", "mass", "masse", "x_1",
        "x1", "upper", "out", "output",
    ),
    "base": (
        "base", "basis", "inferior", "lower", "table", "tisch", "shaker", "input", "ground", "bottom", "unten",
        "fusspunkt", "reference", "x_b", "xb", "x_0", "in",
    ),
    "current": ("current", "coil", "strom", "i", "drive", "amp"),
}  # fmt: skip
"""Words in headings of other programs that suggest a channel, in lower case, by channel."""
_ORDER = ("accelerometer", "laser", "base", "current")
_SEPARATORS = re.compile(r"[\s_.:/()\[\]-]+")
DT_CHANNELS = frozenset({"laser", "base"})  # whose ratio the transmissibility is
LONGEST_GUESSED = 200  # longest heading, in characters, that is compared


def guess(source: ImportedSignals) -> Mapping:
    """Guess the channels, drive frequency and gap of a file from headings, units and the file name.

    Parts of the mapping that cannot be guessed are left out. Channels are found in the largest group of signals with
    common times. If only one of `laser` and `base` is found there, the other may have other times. A signal with the
    name of a channel is that channel. After that, known words in headings decide (`HINTS`), and then units. Without a
    signal for `laser`, the accelerometer's signal is also used for `laser`, if there is a `base`. A signal named
    `frequency` or `gap` takes precedence over the file name.
    """
    free = _of_one_time_base(source.signals)
    chosen: dict[str, Channel] = {}

    def take(channel: str, name: str) -> None:
        chosen[channel] = Channel(column=name, unit=free.pop(name).unit)

    for channel in CHANNELS:
        if channel in free:
            take(channel, channel)
    for channel in _ORDER:
        if channel not in chosen and (name := _meant(channel, HINTS[channel], free)) is not None:
            take(channel, name)
    for channel in ("accelerometer", "current"):
        if channel not in chosen:
            matching = [name for name, one in free.items() if one.unit and quantity(one.unit) == UNITS[channel][0]]
            if len(matching) == 1:
                take(channel, matching[0])
    if len(DT_CHANNELS & chosen.keys()) == 1:  # the other may have times of its own, which the conversion then names
        (missing,) = DT_CHANNELS - chosen.keys()
        free = {
            name: one
            for name, one in source.signals.items()
            if one.kind is SignalKind.TIME_RESPONSE and name not in {used.column for used in chosen.values()}
        }
        if (name := _meant(missing, (missing, *HINTS[missing]), free)) is not None:
            take(missing, name)
    if "laser" not in chosen and "accelerometer" in chosen and "base" in chosen:
        chosen["laser"] = chosen["accelerometer"]
    stem = source.path.stem[:LONGEST_GUESSED]
    frequency: float | str | None = file_names.frequency_hz(stem)
    gap: float | str | None = file_names.gap_m(stem)
    guessed = {name for name, value in (("frequency", frequency), ("gap", gap)) if value is not None}
    if "frequency" in free:
        frequency = "frequency"
    if "gap" in free:
        gap = "gap"
    return Mapping(channels=chosen, frequency=frequency, gap=gap, guessed=frozenset(guessed - set(free)))


def _meant(channel: str, hints: Sequence[str], signals: AnyMapping[str, Signal]) -> str | None:
    """Return the name of the signal that the words `hints` suggest for a channel; None if no word is unambiguous.

    A word is unambiguous if exactly one signal has it in its name and a unit that is possible for the channel. The
    first unambiguous word decides.
    """
    words = {name: _words(name) for name, one in signals.items() if _fits(one, channel)}
    matching = ([name for name, own in words.items() if hint in own] for hint in hints)
    return next((names[0] for names in matching if len(names) == 1), None)


def _of_one_time_base(signals: AnyMapping[str, Signal]) -> dict[str, Signal]:
    """Return the largest group of time responses that share their times, by name."""
    bases: dict[object, dict[str, Signal]] = {}
    for name, one in signals.items():
        if one.kind is SignalKind.TIME_RESPONSE:
            times = one.abscissa.values
            last = float(times[-1]) if times is not None and len(times) else None
            bases.setdefault((len(one.values), one.abscissa.step, last), {})[name] = one
    largest = max((len(base) for base in bases.values()), default=0)
    return next((base for base in bases.values() if len(base) == largest), {})


def _words(name: str) -> frozenset[str]:
    """Return the words of a heading, and the complete heading, in lower case, for comparison with `HINTS`."""
    lower = name[:LONGEST_GUESSED].casefold()
    return frozenset({lower, *_SEPARATORS.split(lower)})


def _fits(signal: Signal, channel: str) -> bool:
    """Return whether the unit of a signal is possible for a channel.

    Volts, unknown units and missing units are possible for every channel.
    """
    found = quantity(signal.unit) if signal.unit else None
    return found is None or found == "V" or found in UNITS[channel]


def reason_unused(name: str, signals: AnyMapping[str, Signal], mapping: Mapping) -> str:
    """Return the reason, as a text for the user, why no channel uses a signal.

    The reason is empty if the signal gives the frequency or the gap.
    """
    if name in (mapping.frequency, mapping.gap):
        return ""
    one = signals[name]
    used = [signals[channel.column] for channel in mapping.channels.values() if channel.column in signals]
    if one.kind is not SignalKind.TIME_RESPONSE:
        return f"it is a {one.kind.value}"
    meant = [channel for channel in CHANNELS if {channel, *HINTS[channel]} & _words(name)]
    if not meant:
        return "its name matches no channel"
    fitting = [channel for channel in meant if _fits(one, channel)]
    if not fitting:
        return f"its unit {one.unit} is not possible for the channel {meant[0]}"
    taken = [channel for channel in fitting if channel in mapping.channels]
    if taken:
        return f"the channel {taken[0]} uses the signal {mapping.channels[taken[0]].column}"
    if all(len(one.values) != len(other.values) for other in used):
        return f"it has {len(one.values)} values, unlike the signals of the channels"
    rivals = [other for other in signals if other != name and {fitting[0], *HINTS[fitting[0]]} & _words(other)]
    return f"{rivals[0]} could also be the channel {fitting[0]}" if rivals else "it is not assigned to a channel"


def with_channel(channels: AnyMapping[str, Channel], text: str, signals: AnyMapping[str, Signal]) -> dict[str, Channel]:
    """Return channels with one channel changed as the text of an option `--channel` states.

    The text names the channel and its signal, optionally with unit and sensitivity: `laser=ai0`, `laser=ai0 mm`,
    `laser=ai0 V, 500 mV/mm`. The text `laser=` removes the channel. Unit and sensitivity of the channel are replaced.
    If the text states no unit, the unit of the signal applies. Other properties of the channel, such as its sign, are
    kept. The name of the signal need not be in `signals`; such a name ends at the first blank or comma.

    Raises:
        ConfigError: the text is malformed, or its channel is unknown.
    """
    name, equals, rest = text.partition("=")
    name = name.strip()
    if not equals or name not in CHANNELS:
        raise ConfigError(
            f"--channel must be like laser=ai0, laser='ai0 mm' or laser='ai0 V, 500 mV/mm', with one of the channels "
            f"{', '.join(CHANNELS)}; got {text!r}, {'whose channel is unknown' if equals else 'which contains no ='}"
        )
    changed = dict(channels)
    rest = rest.strip()
    if not rest:
        changed.pop(name, None)
        return changed
    column = _longest(rest, signals)
    unit, comma, sensitivity = rest[len(column) :].strip().partition(",")
    unit, sensitivity = unit.strip(), sensitivity.strip()
    if not comma and "/" in unit and unit[:1].isdigit():  # only a sensitivity
        unit, sensitivity = "", unit
    stated = signals[column].unit if column in signals else ""
    known = attrs.evolve(channels[name], column=column) if name in channels else Channel(column=column)
    changed[name] = attrs.evolve(known, unit=unit or stated or ("V" if sensitivity else ""), sensitivity=sensitivity)
    return changed


def _longest(text: str, signals: AnyMapping[str, Signal]) -> str:
    """Return the longest signal name with which the text begins; without such a name, the first word of the text."""
    matching = [name for name in signals if text == name or text.startswith((f"{name} ", f"{name},"))]
    return max(matching, key=len) if matching else re.split(r"[\s,]", text, maxsplit=1)[0]
