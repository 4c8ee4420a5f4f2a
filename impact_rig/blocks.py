"""The tables that travel: one numpy dtype per table topic, and `Table`, a stamped structured array.

Columns are named and typed; `time` is always seconds since the table's stamp; indices are f8 (exact to 2**53) because
`sensor_msgs/PointField` has no 64-bit integers; text is UTF-8 in 32 bytes. `docs/interface.md` lists unit and meaning
of every column.
"""

from __future__ import annotations

import attrs
import numpy as np
from numpy.typing import NDArray

TEXT = "S32"
FRAME_DAQ = "daq"

CHANNELS = ("accelerometer", "laser", "base", "current")
"""DAQ channels in scan order: channel j is converted j conversion intervals after the scan clock; its bit in `status`
is 1 << j."""

SCAN = np.dtype([("time", "f8"), *[(name, "f8") for name in CHANNELS], ("status", "u1")])

TRUTH_SCAN = np.dtype(
    [
        (name, "f8")
        for name in (
            "time",
            "x_b",
            "x_1",
            "x_2",
            "v_b",
            "v_1",
            "v_2",
            "a_b",
            "a_1",
            "a_2",
            "current",
            "force_left",
            "force_right",
        )
    ]
)

IMPACTS = np.dtype(
    [
        ("time", "f8"),
        ("wall", "i1"),
        ("approach_speed", "f8"),
        ("separation_speed", "f8"),
        ("peak_force", "f8"),
        ("peak_indentation", "f8"),
        ("impulse", "f8"),
        ("duration", "f8"),
        ("energy_lost", "f8"),
    ]
)
"""`truth/impacts`: one row per contact; wall is -1 left, +1 right; speeds relative to the wall, both positive."""

APPLIED = np.dtype([("time", "f8"), ("sample", "f8"), ("frequency", "f8"), ("current", "f8"), ("phase", "f8")])
"""`shaker/applied`: one row per accepted change; `sample` is the first scan it acts on, `phase` [rad] the drive's phase
there."""

JOURNAL = np.dtype(
    [
        ("time", "f8"),
        ("sample", "f8"),
        ("sequence", "f8"),
        ("kind", TEXT),
        ("key", TEXT),
        ("value", "f8"),
        ("text", TEXT),
    ]
)

FAULTS = np.dtype(
    [
        ("time", "f8"),
        ("sample", "f8"),
        ("id", "f8"),
        ("kind", TEXT),
        ("channel", TEXT),
        ("active", "u1"),
        ("value", "f8"),
        ("duration", "f8"),
    ]
)

DAQ_INFO = np.dtype(
    [
        ("name", TEXT),
        ("unit", TEXT),
        ("rate", "f8"),
        ("range_low", "f8"),
        ("range_high", "f8"),
        ("sensitivity", "f8"),
        ("offset", "f8"),
        ("resolution", "f8"),
        ("noise", "f8"),
        ("sensitivity_uncertainty", "f8"),
        ("offset_uncertainty", "f8"),
        ("lag", "f8"),
        ("skew", "f8"),
        ("lag_order", "f8"),
        ("bandwidth", "f8"),
        ("linearity", "f8"),
        ("since_start", "f8"),
    ]
)
"""`daq/info`, one row per channel: SI = (volt - offset) / sensitivity; sensitivity in V per unit, offset in V; range,
resolution (1 LSB) and noise (rms) in the unit; u(sensitivity) relative and u(offset) in the unit, both standard
uncertainties; lag: group delay of the sensor at low frequency [s]; skew: conversion after the scan clock [s];
lag_order 1: the sensor is a first-order lag 1 / (1 + jω lag), 0: a pure delay in the rig's band; bandwidth: -3 dB
corner of the sensor and of its noise [Hz]; linearity: limit of the departure from a straight line [unit], a smooth
curve; its slope at mid-range is part of u(sensitivity); since_start: from scan 0 to this stamp [s], 0 after a reset."""

SETTINGS = np.dtype([("key", TEXT), ("value", "f8")])
"""`analysis/settings`: every setting of the measurement in force from the stamp on, the operator's label `gap_m` [m]
among them (0 = no sphere, NaN = unknown)."""

TRANSMISSIBILITY = np.dtype(
    [
        (name, "f8")
        for name in (
            "time",
            "frequency",
            "transmissibility",
            "phase",
            "transmissibility_uncertainty",
            "phase_uncertainty",
            "laser_amplitude",
            "base_amplitude",
            "current_amplitude",
            "thd",
            "impacts_per_cycle",
            "settled",
            "cycles",
            "gap",
            "frequency_deviation",
            "spread",
            "period",
            "waited",
        )
    ]
    + [("regime", TEXT), ("method", TEXT), ("status", TEXT)]
)
"""`transmissibility/table`, one row per measurement; phase [rad] of x_1 relative to x_b, negative = lagging; gap [m],
0 = no sphere, NaN = unknown; frequency_deviation [Hz]: measured less commanded; spread: standard deviation of the
transmissibility from cycle to cycle; period [drive cycles] of a periodic response, else NaN; waited [s] from the last
change to the end of the measurement; regime, method and status are the words of `impact_rig.analysis.words`."""

DETECTED_IMPACTS = np.dtype([("time", "f8"), ("peak", "f8"), ("sign", "i1")])
"""`impacts`: detected from the accelerometer alone; peak [m/s^2]; sign +1 when the structure is pushed to the right
(the right wall is struck)."""


@attrs.frozen(eq=False)
class Table:
    """A stamped structured array: what one PointCloud2 message carries.

    Attributes:
        stamp_ns: header stamp [ns].
        rows: structured array, shape (n,).
        frame_id: header frame.
    """

    stamp_ns: int
    rows: NDArray[np.void]
    frame_id: str = FRAME_DAQ
