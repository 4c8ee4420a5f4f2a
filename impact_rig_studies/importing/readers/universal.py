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
"""Reader of universal files (UFF 58 and 58b), with pyuff, for every kind of abscissa and function."""

from __future__ import annotations

import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any  # datasets of pyuff

import numpy as np

from impact_rig.errors import RecordingError
from impact_rig_studies.importing import units
from impact_rig_studies.importing.limits import check_column_count, check_value_count
from impact_rig_studies.importing.signals import (
    Abscissa,
    AbscissaKind,
    ImportedSignals,
    Signal,
    SignalKind,
    UniqueNames,
    reasons,
)

FUNCTIONS = {
    0: "general or unknown", 1: "time response", 2: "auto spectrum", 3: "cross spectrum",
    4: "frequency response function", 5: "transmissibility", 6: "coherence", 7: "auto correlation",
    8: "cross correlation", 9: "power spectral density", 10: "energy spectral density",
    11: "probability density function", 12: "spectrum", 13: "cumulative frequency distribution",
    14: "peaks valley", 15: "stress/cycles", 16: "strain/cycles", 17: "orbit", 18: "mode indicator function",
    19: "force pattern", 20: "partial power", 21: "partial coherence", 22: "eigenvalue", 23: "eigenvector",
    24: "shock response spectrum", 25: "finite impulse response filter", 26: "multiple coherence", 27: "order function",
    28: "phase compensation",
}  # fmt: skip
TIME, FREQUENCY, UNKNOWN = 17, 18, 0  # specific data types of an abscissa
UNITLESS = (0, 1)  # specific data types without a quantity: unknown, general
QUANTITIES = {8: "displacement", 11: "velocity", 12: "acceleration"}  # specific data types of an ordinate
SYSTEMS = {1: "m", 3: "m", 5: "mm", 6: "cm", 7: "in", 9: "mm"}  # unit of length by the code of dataset 164
_PER_SECONDS = {8: "", 11: "/s", 12: "/s^2"}
SINGLE_DIGITS = 6  # significant digits of header values (format 13.5e)
READABLE = (58, 164)


def read(path: Path, content: bytes, library: ModuleType) -> ImportedSignals:
    """Read the time responses of a universal file.

    All other datasets, except those of units, are left out, with the reason for the user. A function of the general
    type (0) is a time response if its header states that it is over time. `library` is pyuff.

    Raises:
        RecordingError: there is no time response; the message names the reasons.
        BudgetError: there are too many datasets, or they have more values than a file of this size may contain.
    """
    with tempfile.TemporaryDirectory(prefix="impact_rig_uff_") as folder:  # pyuff opens files by name only
        named = Path(folder) / "all.uff"
        named.write_bytes(content)
        file = library.UFF(str(named))
        types = [int(kind) for kind in file.get_set_types()]
        check_column_count(len(types))
        left_out: dict[str, str] = {}
        if not content.rstrip().endswith(b"-1"):
            left_out["end of the file"] = "the line -1 that ends a dataset is missing, the file may be cut off"
        signals: dict[str, Signal] = {}
        names = UniqueNames()
        system = ""
        total = 0
        for number, kind in enumerate(types):
            label = f"dataset {number + 1}"
            if kind not in READABLE:
                left_out[label] = f"of type {kind}, which is not a function (type 58)"
                continue
            try:
                one = file.read_sets(number)
            except Exception as error:  # any error that pyuff raises for a damaged dataset
                left_out[label] = f"damaged or cut off: {' '.join(str(error).split())[:80] or type(error).__name__}"
                continue
            if kind == 164:
                system = SYSTEMS.get(int(one.get("units_code", 0)), "")
                continue
            data = np.asarray(one["data"])
            total += data.size
            check_value_count(total, len(content))
            _add(one, data, number, system, signals, names, left_out)
    if not signals:
        why = f": {reasons(left_out)}" if left_out else ""
        raise RecordingError(
            f"{path} holds no time response (dataset 58, function type 1){why}; export the measured signals over time"
        )
    return ImportedSignals(path, "universal file", signals, left_out=left_out)


def _add(
    one: dict[str, Any],
    data: Any,
    number: int,
    system: str,
    signals: dict[str, Signal],
    names: UniqueNames,
    left_out: dict[str, str],
) -> None:
    """Add a dataset of type 58 to `signals` if it is a real time response, otherwise to `left_out` with the reason.

    `number` is the position of the dataset in the file from 0. `system` is the unit of length for values without a
    unit.
    """
    words = [str(one.get(key, "")).strip() for key in ("id1", "rsp_ent_name")]
    plain = next((word for word in words if word and word.upper() != "NONE"), f"dataset_{number}")
    label = f"dataset {number + 1} ({plain})"
    function = int(one.get("func_type", 0))
    abscissa = _abscissa(one, len(data))
    quantity = int(one.get("abscissa_spec_data_type", 0) or 0)
    if function not in (0, 1):
        left_out[label] = f"a function of type {function}: {FUNCTIONS.get(function, 'unknown')}"
        return
    if np.iscomplexobj(data):
        left_out[label] = "complex numbers: a spectrum"
        return
    if abscissa.kind is AbscissaKind.FREQUENCY:
        left_out[label] = "a spectrum: its abscissa is a frequency"
        return
    if abscissa.kind is not AbscissaKind.TIME:
        left_out[label] = f"no time response: its abscissa is of type {quantity} [{abscissa.unit or 'no unit'}]"
        return
    stated = [_label(one.get(key)) for key in ("abscissa_axis_units_lab", "abscissa_axis_lab")]
    if function == 0 and quantity == UNKNOWN and not any(stated):
        left_out[label] = "neither its function type nor its abscissa states that it is over time"
        return
    if not np.isfinite(abscissa.start):
        left_out[label] = "the first value of its abscissa is not a finite number"
        return
    node = f"{one.get('rsp_node', 0)}:{one.get('rsp_dir', 0)}"
    name = names.unique(plain if plain not in signals else f"{plain} {node}")
    signals[name] = Signal(
        np.asarray(data, np.float64), _unit(one, system), abscissa, SignalKind.TIME_RESPONSE, f"dataset {number + 1}"
    )


def _abscissa(one: dict[str, Any], count: int) -> Abscissa:
    """Return the abscissa of a dataset with `count` values: evenly spaced times from its header, or listed times [s].

    The kind is not `TIME`, and there are no values, if the abscissa is not a time. The same applies to an increment
    that is not finite and > 0, and to listed times whose number is not `count`.
    """
    quantity = int(one.get("abscissa_spec_data_type", UNKNOWN) or UNKNOWN)
    unit = _label(one.get("abscissa_axis_units_lab"))
    words = _label(one.get("abscissa_axis_lab")).lower()
    if quantity not in (TIME, UNKNOWN) or units.quantity(unit or "s") == "Hz" or words.startswith("freq"):
        kind = AbscissaKind.FREQUENCY if quantity in (FREQUENCY, TIME, UNKNOWN) else AbscissaKind.OTHER
        return Abscissa(kind, unit)
    factor = units.unit_factor(unit, "s") if unit and units.quantity(unit) == "s" else None if unit else 1.0
    if factor is None:
        return Abscissa(AbscissaKind.OTHER, unit)
    x = np.asarray(one["x"], np.float64) * factor
    if int(one.get("abscissa_spacing", 0)) == 1:
        step = float(one.get("abscissa_inc", 0.0)) * factor
        start = float(one.get("abscissa_min", 0.0)) * factor
        if not (np.isfinite(step) and step > 0.0):
            return Abscissa(AbscissaKind.OTHER, unit, note=f"its increment is {step:g}")
        resolution = 0.51 * 10.0 ** (np.floor(np.log10(step)) - SINGLE_DIGITS + 1)
        return Abscissa(AbscissaKind.TIME, unit or "s", start, step, None, float(resolution))
    if len(x) != count or not count:
        return Abscissa(AbscissaKind.OTHER, unit, note="times and values differ in number")
    return Abscissa(AbscissaKind.TIME, unit or "s", float(x[0]), None, x - x[0])


def _unit(one: dict[str, Any], system: str) -> str:
    """Return the unit of a dataset's values; empty if it is unknown.

    It is the stated unit, or else the unit of their quantity with `system` as unit of length. For values per another
    quantity, such as an impulse response in mm/N, the unit of that quantity is appended.
    """
    label = _label(one.get("ordinate_axis_units_lab"))
    quantity, below = (int(one.get(f"{name}_spec_data_type", 0) or 0) for name in ("ordinate", "orddenom"))
    unit = label or (system + _PER_SECONDS[quantity] if system and quantity in QUANTITIES else "")
    if below not in UNITLESS:
        unit = f"{unit or '?'}/{_label(one.get('orddenom_axis_units_lab')) or f'quantity {below}'}"
    return unit


def _label(value: object) -> str:
    text = str(value or "").strip()
    return "" if text.upper() == "NONE" else text
