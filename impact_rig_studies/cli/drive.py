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
"""`impact-rig drive`: tests that drive a rig, each with its own options."""

from __future__ import annotations

from impact_rig.cli.terminal import Commands, subcommand
from impact_rig_studies.cli import drive_sine, drive_stream


def add_command(commands: Commands) -> None:
    """Register the command and its tests, in the order of the help."""
    parser = subcommand(
        commands, "drive", None, "drive a rig: signals, sine sweeps, controlled amplitudes, resonances, shocks",
        [
            ("drive play road.csv --signal drive --scale 0.5", "half of a column as the current"),
            ("drive sweep --gap 6mm", "DT over the frequency at a constant current"),
            ("drive hold base 60um --frequencies 8.8 9.1 9.4", "the base at 60 µm, at three frequencies"),
            ("drive lock --gap none", "find the resonance without a sphere, and track it"),
            ("drive random --gap none", "a power spectral density of the base's acceleration, 5 to 200 Hz"),
        ],
        "`impact-rig drive TEST --help` shows the options of a test. Each writes its results to a new directory, whose "
        "name is the last line of its output.",
    )  # fmt: skip
    tests = parser.add_subparsers(dest="test", required=True, metavar="TEST", help="kind of test")
    for add in (
        drive_stream.add_play, drive_stream.add_frf, drive_sine.add_hold, drive_sine.add_sweep, drive_sine.add_lock,
        drive_sine.add_backbone, drive_stream.add_random, drive_stream.add_replicate, drive_stream.add_shock,
    ):  # fmt: skip
        add(tests)
