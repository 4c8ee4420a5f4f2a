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
"""Command `impact-rig check`: validation of a configuration file and of its instruments, without starting a rig."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence

import attrs
from rich.text import Text

from impact_rig.cli.terminal import Console, TextTable, tell_json
from impact_rig.errors import ConfigError
from impact_rig.instruments import check_known_input
from impact_rig.instruments.checks import ChannelCheck
from impact_rig.physics.contact import from_config
from impact_rig.rig import Rig
from impact_rig.rig.config import load_config

_POLARITY = {1: "right", 0: "no signal", -1: "reversed"}


def run_check(arguments: argparse.Namespace) -> int:
    """Run `impact-rig check`: print that a configuration is valid; with `--instruments`, also test each channel.

    The test applies a known sine to each channel. Return exit code 1 if a channel fails, else 0.

    Raises:
        ConfigError: the configuration is invalid.
    """
    config = load_config(arguments.path)
    try:
        Rig(config)  # individually valid values may be jointly invalid
    except ConfigError as error:
        raise ConfigError(f"{error} ({arguments.path})") from error
    law = from_config(config.contact)
    console = Console(quiet=arguments.json)
    console.print(
        f"{arguments.path}: valid; contact law {config.contact.law}, coefficient of restitution {law.restitution:g} "
        f"as configured, {law.realised_restitution():.4f} in simulated impacts"
    )
    checks = check_known_input(config) if arguments.instruments else []
    if arguments.json:
        tell_json(
            {
                "path": str(arguments.path),
                "valid": True,
                "contact_law": config.contact.law,
                "restitution_nominal": law.restitution,
                "restitution_realised": law.realised_restitution(),
                "instruments": [attrs.asdict(one) for one in checks],
            }
        )
    elif checks:
        _print_instruments(checks, console)
    return 0 if all(one.ok for one in checks) else 1


def _print_instruments(checks: Sequence[ChannelCheck], console: Console) -> None:
    table = TextTable(
        title="Response of every channel to a known sine, compared with its calibration certificate",
        caption="residual: rms of the readings minus the fitted sine, in % of the limit for noise and nonlinearity",
    )
    for heading in ("channel", "gain error", "limit", "phase", "residual", "polarity", ""):
        table.add_column(heading, justify="left" if heading in {"channel", ""} else "right", no_wrap=True)
    for check in checks:
        table.add_row(
            check.channel,
            f"{100.0 * (abs(check.gain) - 1.0):+z.3f} %",
            f"± {100.0 * check.gain_limit:.2f} %",
            f"{math.degrees(check.phase_rad):+z.3f}°",
            f"{100.0 * check.residual / check.residual_limit:.0f} %",
            _POLARITY[check.polarity],
            Text("ok", "green") if check.ok else Text("not ok", "red"),
        )
    console.print(table)
