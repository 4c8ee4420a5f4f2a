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
"""Columns and row types of all topics that carry tables, and `Table`, the content of one message of such a topic.

Each kind of table has a tuple of columns (such as `FAULTS_COLUMNS`) and a row type made from these columns (`FAULTS`).
`time` is in seconds since the table's stamp. `docs/reference/interface.md` is generated from these columns.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import attrs
import numpy as np
from numpy.typing import NDArray

TEXT = "S32"
TEXT_BYTES = 32  # text in a table: UTF-8 in 32 bytes
NUMBER = "f8"  # also for indices: exact to 2**53, and `sensor_msgs/PointField` has no 64-bit integers


LONGEST_S = 2.0**32  # largest difference of two stamps [s]
LARGEST_INDEX = 2.0**53  # up to which integers are exact in a table


@attrs.frozen
class Column:
    """Column of a table, with its allowed values.

    `codec.checked` rejects all other values.

    Attributes:
        name: name of the column.
        unit: SI unit, `-` for none, or a phrase such as `by kind` if it depends on the row.
        doc: description, with the meaning of values that are not measurements, such as NaN.
        kind: numpy type code.
        default: value for tables of an earlier version that lack the column; None if the column is required.
        least: smallest allowed value; a column with a bound or `whole` must not contain NaN.
        most: largest allowed value.
        whole: whether only integers are allowed.
        is_part: whether a text of the column may be a piece of a longer text. A piece may begin or end within a
            character, so it need not be valid UTF-8.
    """

    name: str
    unit: str
    doc: str
    kind: str = NUMBER
    default: float | str | None = attrs.field(default=None, kw_only=True)
    least: float = attrs.field(default=-math.inf, kw_only=True)
    most: float = attrs.field(default=math.inf, kw_only=True)
    whole: bool = attrs.field(default=False, kw_only=True)
    is_part: bool = attrs.field(default=False, kw_only=True)

    def __attrs_post_init__(self) -> None:
        assert self.kind == NUMBER or not self.is_bounded, f"{self.name}: a column with a bound must be {NUMBER}"

    @property
    def is_bounded(self) -> bool:
        """Return whether `least`, `most` or `whole` restricts the column's numbers."""
        return self.whole or self.least > -math.inf or self.most < math.inf

    def allowed(self) -> str:
        """Return the allowed numbers of a bounded column as text for an error message.

        An example is `a number from 1 to 10`.
        """
        number = "a whole number" if self.whole else "a number"
        if self.least > -math.inf and self.most < math.inf:
            return f"{number} from {self.least:.10g} to {self.most:.17g}"
        return number + (f" from {self.least:.10g} on" if self.least > -math.inf else f" up to {self.most:.10g}")


def time(doc: str) -> Column:
    """Return the column `time` of a table, in seconds since the table's stamp, with the description `doc`."""
    return Column("time", "s", doc, least=-LONGEST_S, most=LONGEST_S)


def index(name: str, doc: str) -> Column:
    """Return a column of whole numbers from 0 to 2**53, stored as 64-bit floats, such as the index of a scan."""
    return Column(name, "-", doc, least=0.0, most=LARGEST_INDEX, whole=True)


def row_type(columns: Iterable[Column]) -> np.dtype[np.void]:
    """Return the structured numpy type of rows with the given columns, in this order and without padding."""
    return np.dtype([(column.name, column.kind) for column in columns])


FRAME_DAQ = "daq"
MOST_HZ = 1e6  # the board's aggregate rate, which limits the memory that a hostile table can request

SCAN_COMMON_COLUMNS = (
    time("Scan clock, since the stamp; a channel is converted its `skew` later (daq/info)."),
    Column("status", "-", "Bit j: channel j (in the order of these columns, from 0) is over range or clipped.", "u1"),
)
"""Columns that every scan has; those of the channels follow from the instruments, `impact_rig.instruments.section`."""

TRUTH_SCAN_COLUMNS = (
    time("Scan clock, since the stamp."),
    Column("x_b", "m", "Position of the inferior base."),
    Column("x_1", "m", "Position of the superior base."),
    Column("x_2", "m", "Position of the sphere."),
    Column("v_b", "m/s", "Velocity of the inferior base."),
    Column("v_1", "m/s", "Velocity of the superior base."),
    Column("v_2", "m/s", "Velocity of the sphere."),
    Column("a_b", "m/s^2", "Acceleration of the inferior base."),
    Column("a_1", "m/s^2", "Acceleration of the superior base."),
    Column("a_2", "m/s^2", "Acceleration of the sphere."),
    Column("current", "A", "Coil current; 0 where the base motion is prescribed."),
    Column("force_left", "N", "Contact force at the left wall, positive in compression."),
    Column("force_right", "N", "Contact force at the right wall, positive in compression."),
)
TRUTH_SCAN = row_type(TRUTH_SCAN_COLUMNS)

IMPACTS_COLUMNS = (
    time("Start of the contact, since the stamp; negative if the contact began before the block."),
    Column("wall", "-", "-1 left, +1 right.", "i1"),
    Column("approach_speed", "m/s", "Speed of the sphere relative to the wall when the contact begins, positive."),
    Column("separation_speed", "m/s", "Speed of the sphere relative to the wall when the contact ends, positive."),
    Column(
        "peak_force",
        "N",
        "Largest contact force; 0 for the instantaneous law `restitution`, as are peak_indentation and duration.",
    ),
    Column("peak_indentation", "m", "Largest indentation of sphere and wall together."),
    Column("impulse", "N s", "Integral of the contact force over the contact."),
    Column("duration", "s", "Time from the start to the end of the contact."),
    Column("energy_lost", "J", "Work that the contact force did not give back."),
)
IMPACTS = row_type(IMPACTS_COLUMNS)

APPLIED_COLUMNS = (
    time("Time of the first scan that the change acts on, since the stamp: 0."),
    index("sample", "Index of the first scan that the change acts on, since the start or reset."),
    Column("frequency", "Hz", "Drive frequency."),
    Column("current", "A", "Amplitude at the end of the ramp, peak (rms for random; m or V by `drive.kind`)."),
    Column("phase", "rad", "Phase of the drive at that scan, in [0, 2π)."),
)
APPLIED = row_type(APPLIED_COLUMNS)

WAVEFORM_COLUMNS = (Column("value", "A, m or V", "Consecutive samples of the drive, unit by `drive.kind`."),)
WAVEFORM = row_type(WAVEFORM_COLUMNS)

STREAM_COLUMNS = (
    time("Time of the sample needed next, since the stamp: 0."),
    index("wanted", "Number of the sample needed next, since the start or reset; all earlier ones have taken effect."),
    Column("buffered", "-", "Samples that are present from `wanted` on, without a gap."),
    Column("capacity", "-", "Largest number of buffered samples."),
    Column("playing", "-", "1 while samples drive the rig, 0 before the first one and after an end or gap."),
    Column("late", "-", "Samples that arrived after their time, since the start or reset; they have no effect."),
    Column("refused", "-", "Blocks of samples that were rejected, since the start or reset."),
    Column("missing", "-", "Samples that had not arrived at their time, since the start or reset."),
    Column("rate", "Hz", "Samples per second."),
)
STREAM = row_type(STREAM_COLUMNS)

FAULTS_COLUMNS = (
    time("Time at which the fault starts or ends, since the stamp."),
    index("sample", "Index of the scan at which the fault starts or ends, since the start or reset."),
    index("id", "Number of the fault since the reset, from 1."),
    Column("kind", "-", "Kind of fault.", TEXT),
    Column("channel", "-", "Channel with the fault; empty for a fault of the whole board.", TEXT),
    Column("active", "-", "1 where the fault starts, 0 where it ends.", "u1"),
    Column("value", "by kind", "Size of the fault, in the unit of its kind."),
    Column("duration", "s", "Planned duration of the fault; 0 = until it is cleared."),
)
FAULTS = row_type(FAULTS_COLUMNS)

DAQ_INFO_COLUMNS = (
    Column("name", "-", "Name of the channel, which is that of its column in daq/scan.", TEXT),
    Column("unit", "-", "Unit of the channel.", TEXT),
    Column("rate", "Hz", "Scans per second; an integer for the rig.", least=1.0, most=MOST_HZ),
    Column("range_low", "unit", "Smallest value that the channel can measure."),
    Column("range_high", "unit", "Largest value that the channel can measure."),
    Column("sensitivity", "V/unit", "SI value = (volt - offset) / sensitivity."),
    Column("offset", "V", "Voltage of the channel where the SI value is 0."),
    Column("resolution", "unit", "The larger of the steps of the sensor's output and of the converter."),
    Column("noise", "unit", "Noise of the readings, rms."),
    Column("sensitivity_uncertainty", "-", "Relative standard uncertainty of the sensitivity."),
    Column("offset_uncertainty", "unit", "Standard uncertainty of the reading at zero."),
    Column("lag", "s", "Group delay of the sensor at low frequency."),
    Column("skew", "s", "Delay of the conversion after the scan clock."),
    Column(
        "lag_order",
        "-",
        "Model of the lag in the rig's band: 1 first-order lag 1 / (1 + jω lag), 2 two-pole Butterworth, 0 pure delay.",
        default=0.0,
    ),
    Column("bandwidth", "Hz", "-3 dB corner of the sensor and of its noise; 0 where unknown.", default=0.0),
    Column(
        "linearity",
        "unit",
        "Limit of the departure from a straight line, a smooth curve; its slope at mid-range is part of "
        "sensitivity_uncertainty.",
        default=0.0,
    ),
    Column(
        "since_start",
        "s",
        "Time from scan 0 to the stamp; 0 after a start or reset.",
        default=0.0,
        least=-LONGEST_S,
        most=LONGEST_S,
    ),
    Column("output_step", "unit", "Step of the sensor's own output, before the converter; 0: none.", default=0.0),
    Column(
        "output_noise", "unit", "Noise before the sensor's output step, rms, which averages that step out.", default=0.0
    ),
    Column("converter_step", "unit", "Step of the converter.", default=0.0),
    Column(
        "converter_noise",
        "unit",
        "Noise of the converter itself, rms, which averages the converter's step out.",
        default=0.0,
    ),
    Column(
        "high_pass",
        "Hz",
        "Corner of the first-order high-pass of the sensor; 0: it measures down to 0 Hz, or the corner is unknown.",
        default=0.0,
    ),
)
DAQ_INFO = row_type(DAQ_INFO_COLUMNS)

TRANSMISSIBILITY_COLUMNS = (
    time("Time of the last scan measured, since the stamp: 0."),
    Column("frequency", "Hz", "Drive frequency as commanded."),
    Column("transmissibility", "-", "Displacement transmissibility |X_1| / |X_b| at the drive frequency."),
    Column("phase", "rad", "Phase of x_1 relative to x_b; negative = lagging."),
    Column("transmissibility_uncertainty", "-", "Standard uncertainty of `transmissibility`."),
    Column("phase_uncertainty", "rad", "Standard uncertainty of `phase`."),
    Column("laser_amplitude", "m", "Amplitude |X_1| of the superior base at the drive frequency, peak."),
    Column("base_amplitude", "m", "Amplitude |X_b| of the inferior base at the drive frequency, peak."),
    Column("current_amplitude", "A", "Amplitude of the coil current at the drive frequency, peak."),
    Column("thd", "-", "Total harmonic distortion of x_1: rms of the harmonics over that of the fundamental."),
    Column("impacts_per_cycle", "-", "Detected impacts per drive cycle."),
    Column("settled", "-", "1 if the transient has decayed, 0 if not."),
    Column("cycles", "-", "Drive cycles measured."),
    Column("gap", "m", "Gap according to the operator's label: 0 = no sphere, NaN = unknown."),
    Column("frequency_deviation", "Hz", "Measured minus commanded frequency.", default=math.nan),
    Column("spread", "-", "Standard deviation of the transmissibility from cycle to cycle.", default=math.nan),
    Column("period", "drive cycles", "Period of the response; NaN if it is not periodic.", default=math.nan),
    Column("waited", "s", "Time from the last change to the end of the measurement.", least=0.0, most=LONGEST_S),
    Column("regime", "-", "Behaviour from cycle to cycle (docs/explanation/analysis.md).", TEXT, default=""),
    Column("method", "-", "Method of the uncertainty (docs/explanation/analysis.md).", TEXT, default=""),
    Column("status", "-", "Status of the row (docs/explanation/analysis.md); numbers are NaN unless measured.", TEXT),
    Column(
        "channel",
        "-",
        "The channel that the status is about, or that contributes most to the uncertainty; empty: none.",
        TEXT,
        default="",
    ),
    Column("largest", "-", "Largest contribution to the uncertainty (docs/explanation/analysis.md).", TEXT, default=""),
    Column(
        "largest_share",
        "-",
        "Share of that largest contribution in the transmissibility's variance, 0 to 1.",
        default=math.nan,
    ),
    Column(
        "steps_uncertainty",
        "-",
        "Part of the transmissibility's standard uncertainty due to the steps of converters and sensors.",
        default=math.nan,
    ),
    Column(
        "impact_age",
        "s",
        "Time from the last detected impact to the stamp; NaN: no impact since the start.",
        default=math.nan,
    ),
)
TRANSMISSIBILITY = row_type(TRANSMISSIBILITY_COLUMNS)

SWEEP_COLUMNS = (
    *TRANSMISSIBILITY_COLUMNS,
    Column(
        "target",
        "m or A",
        "Amplitude to which base, superior base or current is controlled; NaN: none of them is controlled.",
    ),
    Column("error", "-", "Relative deviation of the measured amplitude from `target`; NaN without a target."),
    Column("corrections", "-", "Corrections of the current before the measurement; NaN without a target."),
    Column("held", "-", "1 if `error` is within the tolerance of the sweep, 0 if not; NaN without a target."),
    Column(
        "locked",
        "-",
        "Phase lock, with `phase` relative to the lock's reference: 1 if the phase's mean of the last second is within "
        "the bound, 0 if not; NaN: no phase lock.",
    ),
)
SWEEP = row_type(SWEEP_COLUMNS)

SETTINGS_COLUMNS = (
    Column(
        "key",
        "-",
        "Setting. `gap_m`: label of the operator (0 = no sphere, NaN = unknown). `machine`: number of the machine that "
        "analyses, with its libraries.",
        TEXT,
    ),
    Column("value", "as the key", "Value of the setting, valid from the stamp on."),
)
SETTINGS = row_type(SETTINGS_COLUMNS)

DETECTED_IMPACTS_COLUMNS = (
    time("Time at which the impact was detected, since the stamp."),
    Column("peak", "m/s^2", "Largest acceleration of the pulse, without the vibration (high-pass)."),
    Column("sign", "-", "+1 when the structure is pushed to the right (the right wall is struck), else -1.", "i1"),
)
DETECTED_IMPACTS = row_type(DETECTED_IMPACTS_COLUMNS)


@attrs.frozen(eq=False)
class Table:
    """A stamped structured array: the content of one `sensor_msgs/PointCloud2` message.

    Attributes:
        stamp_ns: stamp of the message in rig time [ns].
        rows: rows, shape (n,), with the topic's columns as fields in SI units; `time` is in seconds since the stamp.
        frame_id: frame of the message (default: daq).

    Examples:
        >>> import impact_rig
        >>> rig = impact_rig.LocalRig()
        >>> rig.run(seconds=0.02)
        >>> for table in rig.tables("daq/scan"):
        ...     print(table.stamp_ns, len(table.rows), table.rows.dtype.names)
        0 100 ('time', 'accelerometer', 'laser', 'base', 'current', 'status')
        10000000 100 ('time', 'accelerometer', 'laser', 'base', 'current', 'status')

    See Also:
        - `encode` and `decode`: convert a table to a ROS message, and back.
        - docs/reference/interface.md: columns of every topic.
    """

    stamp_ns: int
    rows: NDArray[np.void]
    frame_id: str = FRAME_DAQ


def joined(parts: Sequence[NDArray[np.void]]) -> NDArray[np.void]:
    """Return the rows of several arrays of one type, joined in order in a new array; `parts` must not be empty.

    This is about a hundred times faster than `numpy.concatenate`, which compares structured types field by field.
    """
    rows: NDArray[np.void] = np.frombuffer(bytearray().join(parts), parts[0].dtype)  # type: ignore[arg-type]  # buffers
    return rows
