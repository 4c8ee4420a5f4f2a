# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Measurements, impacts and settings as the tables that are published."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any  # settings are integers and floats

import attrs
import numpy as np

from impact_rig.analysis.impacts import Impacts
from impact_rig.analysis.settings import TrackerSettings
from impact_rig.analysis.transmissibility import Measurement
from impact_rig.analysis.words import Status
from impact_rig.blocks import DETECTED_IMPACTS, SETTINGS, TRANSMISSIBILITY, Table
from impact_rig.errors import ConfigError
from impact_rig.simtime import COMMAND_GRID_NS, COMMAND_GRID_S
from impact_rig.system.machine import fingerprint

MACHINE = "machine"
GAP = "gap_m"
RETIRED = ("bootstrap_resamples", "seed")
"""Settings that earlier versions had: of resampling, which is no longer done."""
SETTLED = (Status.OK, Status.ACCELEROMETER_OVER_RANGE, Status.ACCELEROMETER_UNSOUND)


def need_columns(table: Table, wanted: np.dtype[np.void], topic: str, later: Collection[str] = ()) -> None:
    """Refuse a table that lacks a column, or has a text for a number; columns of a later version may be there.

    Args:
        table: any.
        wanted: columns and types.
        topic: named in the refusal.
        later: columns that earlier versions did not have.

    Raises:
        ConfigError: names the topic and the columns.
    """
    found = table.rows.dtype
    if found == wanted:
        return
    names = found.names or ()
    wrong = [
        name
        for name in wanted.names or ()
        if (name not in later if name not in names else (found[name].kind == "S") != (wanted[name].kind == "S"))
    ]
    if wrong:
        raise ConfigError(f"{topic} lacks the column {', '.join(wrong)}, or has another type there")


def measurement_table(found: Measurement, stamp_ns: int, gap_m: float, waited_s: float) -> Table:
    """Return one row of `transmissibility/table`; the stamp is that of the last scan in it."""
    row = np.zeros(1, dtype=TRANSMISSIBILITY)
    row["frequency"] = found.frequency_hz
    row["transmissibility"] = found.transmissibility
    row["phase"] = found.phase_rad
    row["transmissibility_uncertainty"] = found.u_transmissibility
    row["phase_uncertainty"] = found.u_phase_rad
    row["laser_amplitude"] = found.laser_m
    row["base_amplitude"] = found.base_m
    row["current_amplitude"] = found.current_a
    row["thd"] = found.thd
    row["impacts_per_cycle"] = found.impacts_per_cycle
    row["settled"] = found.status in SETTLED
    row["cycles"] = found.cycles
    row["gap"] = gap_m
    row["frequency_deviation"] = found.frequency_deviation_hz
    row["spread"] = found.spread
    row["period"] = found.period
    row["waited"] = waited_s
    row["regime"] = found.regime.value
    row["method"] = found.method.value
    row["status"] = found.status.value
    row["channel"], row["largest"], row["largest_share"] = found.channel, found.largest, found.largest_share
    row["steps_uncertainty"], row["impact_age"] = found.u_steps, found.impact_age_s
    return Table(stamp_ns, row)


def impact_tables(found: Impacts, rate_hz: int, start_ns: int) -> list[Table]:
    """Return detected impacts as tables stamped on the command grid, so that no bit depends on the cut into blocks."""
    seconds = found.scan / rate_hz
    cells = np.floor(seconds / COMMAND_GRID_S).astype(np.int64)
    tables = []
    for cell in np.unique(cells):
        chosen = cells == cell
        rows = np.zeros(int(np.count_nonzero(chosen)), dtype=DETECTED_IMPACTS)
        rows["time"] = seconds[chosen] - cell * COMMAND_GRID_S
        rows["peak"], rows["sign"] = found.peak[chosen], found.sign[chosen]
        tables.append(Table(start_ns + int(cell) * COMMAND_GRID_NS, rows))
    return tables


def settings_table(settings: TrackerSettings, gap_m: float, stamp_ns: int) -> Table:
    """Return `analysis/settings`: settings and the operator's label from an instant on, and which machine analyses."""
    values = {attribute.name: getattr(settings, attribute.name) for attribute in attrs.fields(TrackerSettings)}
    return Table(stamp_ns, np.array([*values.items(), (GAP, gap_m), (MACHINE, fingerprint())], dtype=SETTINGS))


def read_settings(table: Table) -> tuple[TrackerSettings, float]:
    """Return settings and label of `analysis/settings`; what the table does not name has its default.

    Raises:
        ConfigError: a key is unknown, or a value out of range.
    """
    values = dict(zip(table.rows["key"].astype(str).tolist(), table.rows["value"].tolist(), strict=True))
    gap_m = float(values.pop(GAP, np.nan))
    for key in (MACHINE, *RETIRED):
        values.pop(key, None)
    defaults = TrackerSettings()
    unknown = sorted(set(values) - {attribute.name for attribute in attrs.fields(TrackerSettings)})
    if unknown:
        raise ConfigError(f"analysis/settings has an unknown key: {', '.join(unknown)}")
    return TrackerSettings(**{key: _as_set(getattr(defaults, key), value) for key, value in values.items()}), gap_m


def machine_of(table: Table) -> int | None:
    """Return the fingerprint in `analysis/settings` of the machine that analyses, see `machine`; None without."""
    found = table.rows["value"][table.rows["key"] == MACHINE.encode()]
    return int(found[0]) if len(found) and np.isfinite(found[0]) else None


def _as_set(default: float, value: float) -> Any:  # int or float, as the setting is; the validator decides
    """Return a setting as its type; what is no whole number where it should be is left for the validator to refuse."""
    return int(value) if isinstance(default, int) and np.isfinite(value) and value == int(value) else value
