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
"""Complete configuration of a rig, `RigConfig`, and functions that read and write it.

Contact laws and instruments define the settings of their own sections. This module combines all sections. It imports no
compiled code.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import attrs

from impact_rig.blocks import TRUTH_SCAN
from impact_rig.codec import MAX_MESSAGE_BYTES
from impact_rig.config.sections import Barriers, Daq, Drive, Output, Pluck, Shaker, Sphere, Step, Structure, Time
from impact_rig.config.tree import Tree, parameters_in
from impact_rig.errors import ConfigError
from impact_rig.instruments.section import Instruments, row_type_of
from impact_rig.physics.contact import Contact

_OVERHEAD_BYTES = 1000  # upper limit of header and columns in a table's message


@attrs.frozen(kw_only=True)
class RigConfig:
    """Configuration of a rig, one section per part; frozen.

    The defaults are the paper's rig, with the constants that were fitted to its results (`config/nominal.yaml`).
    docs/reference/configuration.md describes every value, with unit, range and origin.

    Attributes:
        structure: superior base on its columns: mass, natural frequency, damping.
        shaker: shaker and inferior base: masses, suspension, force factor, limits.
        drive: drive at the start or reset: kind, waveform, frequency, amplitude.
        sphere: whether there is a sphere; its size, material and start, and the friction of its guide.
        barriers: gap between the barriers, and their material.
        contact: law of the contact between sphere and barriers, and coefficient of restitution.
        daq: data acquisition: scans per second, scans per block, seed of the noise.
        instruments: sensors, converter and planned faults.
        time: rig time relative to wall time: real time, free-running or lockstep.
        step: number of blocks per requested step, in lockstep or while paused.
        pluck: displacement of a pluck test.
        output: monitor rate, frame names and optional topics; command timeout, start of the node.

    Raises:
        ConfigError: values contradict each other, or a block of scans is too large for a message.

    Examples:
        >>> import attrs, impact_rig
        >>> config = impact_rig.RigConfig()
        >>> config.barriers.gap_m, config.daq.rate_hz
        (0.006, 10000)
        >>> wider = attrs.evolve(config, barriers=attrs.evolve(config.barriers, gap_m=0.010))
        >>> wider.barriers.gap_m
        0.01

    See Also:
        - `load_config`: reads a file.
        - `LocalRig`: accepts a configuration, or only the values that differ.
    """

    structure: Structure = attrs.field(factory=Structure)
    shaker: Shaker = attrs.field(factory=Shaker)
    drive: Drive = attrs.field(factory=Drive)
    sphere: Sphere = attrs.field(factory=Sphere)
    barriers: Barriers = attrs.field(factory=Barriers)
    contact: Contact = attrs.field(factory=Contact)
    daq: Daq = attrs.field(factory=Daq)
    instruments: Instruments = attrs.field(factory=Instruments)
    time: Time = attrs.field(factory=Time)
    step: Step = attrs.field(factory=Step)
    pluck: Pluck = attrs.field(factory=Pluck)
    output: Output = attrs.field(factory=Output)

    def __attrs_post_init__(self) -> None:
        shaker, drive = self.shaker, self.drive
        if shaker.frequency_min_hz >= shaker.frequency_max_hz:
            raise ConfigError(
                f"shaker.frequency_min_hz must be < frequency_max_hz = {shaker.frequency_max_hz:g} Hz, "
                f"got {shaker.frequency_min_hz:g} Hz"
            )
        if drive.random_low_hz >= drive.random_high_hz:
            raise ConfigError(
                f"drive.random_low_hz must be < random_high_hz = {drive.random_high_hz:g} Hz, "
                f"got {drive.random_low_hz:g} Hz"
            )
        if not shaker.frequency_min_hz <= drive.frequency_hz <= shaker.frequency_max_hz:
            raise ConfigError(
                f"drive.frequency_hz must be within the shaker's {shaker.frequency_min_hz:g} to "
                f"{shaker.frequency_max_hz:g} Hz, got {drive.frequency_hz:g} Hz"
            )
        if (drive.kind, drive.waveform, drive.stream_hold) == ("prescribed", "stream", "zero_order"):
            raise ConfigError(
                "drive.stream_hold must be first_order for a stream that prescribes the motion of the base "
                "(drive.kind: prescribed), because the base cannot jump, got zero_order"
            )
        scan = row_type_of(self.instruments).itemsize
        most = (MAX_MESSAGE_BYTES - _OVERHEAD_BYTES) // max(scan, TRUTH_SCAN.itemsize * self.output.truth_scan)
        if self.daq.block_scans > most:
            case = " with output.truth_scan" if self.output.truth_scan else ""
            raise ConfigError(
                f"daq.block_scans must be <= {most}{case}, so that a message has at most {MAX_MESSAGE_BYTES} bytes, "
                f"got {self.daq.block_scans}"
            )


TREE = Tree(RigConfig)
parse, dump = TREE.parse, TREE.dump


def load_config(path: Path | str, overrides: Mapping[str, object] | None = None) -> RigConfig:
    """Read a rig configuration from a YAML file.

    Args:
        path: a file with the sections of `RigConfig`, or a ROS 2 parameter file with a single node. Missing values have
            their defaults.
        overrides: values that replace those of the file, by full name, such as `barriers.gap_m`.

    Returns:
        The configuration.

    Raises:
        ConfigError: the file cannot be read, a key is unknown, a value is out of range, or values contradict each
            other. The message names the file, and the key if one is at fault.

    Examples:
        >>> import pathlib, impact_rig
        >>> _ = pathlib.Path("mine.yaml").write_text("barriers: {gap_m: 0.008}")
        >>> impact_rig.load_config("mine.yaml").barriers.gap_m
        0.008
        >>> impact_rig.load_config("mine.yaml", {"barriers.gap_m": 0.004}).barriers.gap_m
        0.004

    See Also:
        - `RigConfig`: its sections.
        - docs/reference/configuration.md: every value, with unit, range and origin.
    """
    return TREE.load(path, overrides)


from_flat, to_flat, differences = TREE.from_flat, TREE.to_flat, TREE.differences
fields = TREE.fields

__all__ = ["TREE", "RigConfig", "differences", "dump", "fields", "from_flat", "load_config", "parameters_in", "to_flat"]
