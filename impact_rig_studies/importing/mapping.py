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
"""Assignment of signals to channels, with units and calibration: guessed, then refined by a YAML text and by options.

SI value = sign · scale · value [unit] / sensitivity + offset       delay and lag as in `analysis.calibration`
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping as AnyMapping
from collections.abc import Sequence

import attrs

from impact_rig.analysis.scans import CHANNELS
from impact_rig.blocks import DAQ_INFO_COLUMNS
from impact_rig.errors import ConfigError, did_you_mean
from impact_rig.names import TOO_LARGE
from impact_rig.system import budget
from impact_rig_studies.importing.units import Sensitivity, quantity, unit_factor

MAPPING_CHARACTERS = 100_000
_MOTION = ("m", "m/s", "m/s^2")
USUAL = {"accelerometer": "g", "laser": "mm", "base": "g", "current": "A"}  # units in examples of a sensitivity
UNITS = {"accelerometer": ("m/s^2",), "laser": _MOTION, "base": _MOTION, "current": ("A",)}
"""SI units that a channel may have; laser and base may be displacements, velocities or accelerations."""
OTHER_UNIT = {"m": "mm", "m/s": "mm/s", "m/s^2": "g", "A": "mA"}
"""SI unit -> another unit of its quantity, as an example in messages."""


@attrs.frozen(kw_only=True)
class Channel:
    """Source of a channel of the rig: the signal in an imported file, with its unit and calibration."""

    column: str  # name of the signal in the file
    unit: str = ""  # unit of its values; empty means that of the file, else SI
    scale: float = 1.0  # factor of a value, before its unit is applied
    sensitivity: str = ""  # such as `100 mV/g`, if the unit is that of a voltage; empty if none
    sign: float = 1.0  # -1 for a sensor mounted the other way round
    offset: float = 0.0  # added at the end [SI unit]
    calibration: AnyMapping[str, float] = attrs.field(factory=dict)
    """Stated properties of the instrument: columns of `daq/info` by name, such as range, noise, lag, uncertainties."""

    def to_si(self, name: str) -> tuple[float, str]:
        """Return the factor that converts values of the signal to SI for the channel `name`, and the SI unit.

        `scale`, `sign` and `offset` are not part of the factor. An empty unit means V if there is a sensitivity,
        otherwise the first of `UNITS`, such as m for a laser.

        Raises:
            ConfigError: the unit or the sensitivity is unknown, or belongs to another quantity.
            RecordingError: the unit needs `pint` (see `units`), which is not installed.
        """
        allowed = UNITS[name]
        if self.sensitivity:
            volts = unit_factor(self.unit or "V", "V")
            if volts is None:
                raise ConfigError(
                    f"the unit of the channel {name} must be V, mV or another unit of voltage, because the channel has "
                    f"a sensitivity ({self.sensitivity}); got {self.unit!r}"
                )
            found = Sensitivity.parse(self.sensitivity)
            if found is None or found.unit not in allowed:
                raise ConfigError(
                    f"the sensitivity of the channel {name} must be a voltage per {' or '.join(allowed)} or unit "
                    f"of the same quantity, like `100 mV/{USUAL[name]}`, got {self.sensitivity!r}"
                )
            return volts / found.volts, found.unit
        if not self.unit:
            return 1.0, allowed[0]
        target = quantity(self.unit)
        factor = unit_factor(self.unit, target) if target in allowed else None
        if factor is None or target is None:
            advice = f'--channel {name}="{self.column} {OTHER_UNIT[allowed[0]]}" states another'
            if unit_factor(self.unit, "V") is not None:
                advice = f'a voltage needs a sensitivity: --channel {name}="{self.column} V, 100 mV/{USUAL[name]}"'
            raise ConfigError(
                f"the unit of the channel {name} must be a unit of {' or '.join(allowed)}, got {self.unit!r} of signal "
                f"{self.column!r}; {advice}"
            )
        return factor, target


def _above_zero(_mapping: object, _field: object, value: float | str | None) -> None:
    if isinstance(value, float) and not 0.0 < value < math.inf:
        raise ConfigError(
            f"the drive frequency (--frequency, or frequency in --mapping) must be finite and > 0 Hz, got {value:g}"
        )


def _not_negative(_mapping: object, _field: object, value: float | str | None) -> None:
    if isinstance(value, float) and not 0.0 <= value < math.inf:
        raise ConfigError(
            f"the gap (--gap, or gap or gap_mm in --mapping) must be 0 (no sphere) or more, and finite, got "
            f"{value * 1e3:g} mm"
        )


@attrs.frozen(kw_only=True)
class Mapping:
    """Meaning of an imported file: the channels of its signals, the scan rate, the drive and the gap."""

    channels: AnyMapping[str, Channel]  # by name
    rate_hz: float | None = None  # rate that replaces the times in the file; None means that these count
    resample_hz: int | None = None  # rate for scans that are not uniform in time; None means that they are rejected
    frequency: float | str | None = attrs.field(default=None, validator=_above_zero)
    """Drive frequency [Hz], or name of the signal with it; None means that it is found in the measured motion."""
    amplitude: float = math.nan  # commanded amplitude [A], for a prescribed base [m]; NaN means that it is measured
    gap: float | str | None = attrs.field(default=None, validator=_not_negative)
    """Gap [m], 0 without sphere, or name of the signal with it [m]; None if unknown."""
    notes: tuple[str, ...] = ()  # remarks for the run
    guessed: frozenset[str] = attrs.field(default=frozenset(), eq=False)
    """Those of the fields frequency and gap that are only guessed from the name of the file, and not stated."""


def refined(mapping: Mapping, text: str) -> Mapping:
    """Return a mapping in which the values of a YAML text replace those of `mapping`; all other values are kept.

    The text is that of the option `--mapping`. Keys of a channel that the text does not state are also kept. A channel
    that is null in the text is removed. An example:

        rate_hz: 5000
        frequency: 9.1               # Hz, or the name of a column
        gap_mm: 6                    # 0 without sphere; or gap: the name of a column, in metres
        channels:
          laser: {column: ai0, unit: V, sensitivity: 500 mV/mm, sign: -1, sensitivity_uncertainty: 0.01}

    Raises:
        ConfigError: the text is not plain YAML, or one of its keys or values is invalid, such as null for a number.
    """
    try:
        content = budget.load_yaml(text, MAPPING_CHARACTERS)
    except budget.PlainYamlError as error:
        raise ConfigError(f"the mapping of signals to channels is not plain YAML: {error}") from error
    given = _section("the mapping", content)
    _refuse_unknown(
        "", given, ("rate_hz", "resample_hz", "frequency", "amplitude", "gap", "gap_mm", "notes", "channels")
    )
    channels = dict(mapping.channels)
    for name, value in _section("channels", given.get("channels")).items():
        if name not in CHANNELS:
            raise ConfigError(f"unknown channel channels.{name}; the channels are {', '.join(CHANNELS)}")
        if value is None:
            channels.pop(name, None)
        else:
            channels[name] = _channel(name, _section(f"channels.{name}", value), channels.get(name))
    changes: dict[str, object] = {"channels": channels}
    for key in ("rate_hz", "amplitude"):
        if key in given:
            changes[key] = _number(key, given[key])
    if "resample_hz" in given:
        changes["resample_hz"] = round(_number("resample_hz", given["resample_hz"]))
    for key in ("frequency", "gap"):
        if key in given:
            value = given[key]
            changes[key] = value if isinstance(value, str) else _number(key, value)
    if "gap_mm" in given:
        changes["gap"] = 1e-3 * _number("gap_mm", given["gap_mm"])
    if "notes" in given:
        notes = given["notes"] if isinstance(given["notes"], list) else [given["notes"]]
        changes["notes"] = tuple(_text(one) for one in notes if one is not None)
    changes["guessed"] = mapping.guessed - {"gap" if key == "gap_mm" else key for key in given}
    return attrs.evolve(mapping, **changes)  # type: ignore[arg-type]  # checked above


def as_yaml(mapping: Mapping) -> str:
    """Return a mapping as a YAML text.

    `refined` restores the mapping from this text and an empty mapping, except for `guessed`.
    """
    content: dict[str, object] = {
        "channels": {
            name: {
                **{key: value for key, value in attrs.asdict(one).items() if key != "calibration"},
                **dict(one.calibration),
            }
            for name, one in mapping.channels.items()
        },
        **{key: getattr(mapping, key) for key in ("rate_hz", "resample_hz", "frequency", "gap")},
        "amplitude": None if math.isnan(mapping.amplitude) else mapping.amplitude,
        "notes": list(mapping.notes),
    }
    texts = {key: json.dumps(value, ensure_ascii=False) for key, value in content.items() if value not in (None, [])}
    lines = [f"{key}: {_WHOLE_BY_POWER.sub(lambda m: m[1] or f'{m[2]}.0e', text)}" for key, text in texts.items()]
    return "\n".join(lines) + "\n"


_WHOLE_BY_POWER = re.compile(r'("(?:[^"\\]|\\.)*")|(?<![\d.])(\d+)e')
"""Pattern of a quoted text, or of the start of a number such as 1e-06, which needs a point to be a number in YAML."""

CALIBRATION = tuple(column.name for column in DAQ_INFO_COLUMNS if column.name not in ("name", "unit", "rate"))
_OWN = ("column", "unit", "scale", "sensitivity", "sign", "offset")


def _channel(name: str, given: AnyMapping[str, object], known: Channel | None) -> Channel:
    _refuse_unknown(f"channels.{name}.", given, (*_OWN, *CALIBRATION))
    values: dict[str, object] = {}
    for key in ("column", "unit", "sensitivity"):
        if key in given:
            if given[key] is None:
                raise ConfigError(f"channels.{name}.{key} must be a text, got null: omit the key")
            values[key] = _text(given[key])
    for key in ("scale", "sign", "offset"):
        if key in given:
            values[key] = _number(f"channels.{name}.{key}", given[key])
    figures = {k: _number(f"channels.{name}.{k}", given[k]) for k in CALIBRATION if k in given and k not in _OWN}
    if known is None:
        if "column" not in values:
            raise ConfigError(f"channels.{name}.column is missing: state the name of a signal in the imported file")
        known = Channel(column=str(values["column"]))
    return attrs.evolve(known, **values, calibration={**known.calibration, **figures})  # type: ignore[arg-type]


def _section(key: str, value: object) -> dict[str, object]:
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise ConfigError(f"{key} must be `key: value` pairs, got {_text(value)[:60]!r}")
    return {str(name): one for name, one in value.items()}


def _refuse_unknown(where: str, given: AnyMapping[str, object], known: Sequence[str]) -> None:
    for name in given:
        if name not in known:
            meant = did_you_mean(name, known) or f", known: {', '.join(known)}"
            raise ConfigError(f"unknown key {where}{name}{meant}")


def _number(key: str, value: object) -> float:
    try:
        number = float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else math.nan
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ConfigError(f"{key} must be a finite number, got {_text(value)[:60]!r}")
    return number


def _text(value: object) -> str:
    try:
        return str(value)
    except ValueError:  # Python does not print the longest integers
        return TOO_LARGE
