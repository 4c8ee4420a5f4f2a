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
"""Parsers of the commands of this package.

The module of a command is imported only when the command runs.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

import attrs

from impact_rig.cli.options import Commands, add_config, add_figures, add_json, add_output, add_rig, add_run, subcommand
from impact_rig.cli.quantities import Quantity, positive
from impact_rig.config import Drive, FieldInfo
from impact_rig.embedded import VERSIONS

SECONDS = 60.0
FREQUENCY = attrs.fields(Drive).frequency_hz
FREQUENCY_HZ, CURRENT_A = FREQUENCY.default, 0.52
CURRENT = Quantity(FieldInfo("Peak current.", "A", low=0.0))


def add_record(commands: Commands) -> None:
    """Register the command `impact-rig record` with its options."""
    parser = subcommand(
        commands,
        "record",
        "impact_rig.cli.record:run_record",
        "record one run at one frequency and current, and measure its displacement transmissibility DT",
        [
            ("record --frequency 9.1 --current 0.52 --gap 6mm", "60 s of rig time, in this process"),
            ("record --gap none --seconds 30 --output runs/no_sphere", "without the sphere"),
            ("record --through running --namespace /rig --seconds 20", "a running rig, with its present drive"),
        ],
        "The last printed line is the directory of the run. Exit code 0: the run has its full length, and DT was "
        "measured; 1: it ended early, or DT was not measured, for the printed reason.",
    )
    parser.add_argument(
        "--frequency",
        type=Quantity.of(FREQUENCY),
        metavar="HZ",
        help=f"drive frequency (default: {FREQUENCY_HZ}Hz; running rig: unchanged)",
    )
    parser.add_argument(
        "--current",
        type=CURRENT,
        metavar="A",
        help=f"peak coil current of the shaker (default: {CURRENT_A}A; running rig: unchanged); if given for a running "
        "rig, it is set to 0 at the end, also if the run ends early",
    )
    parser.add_argument(
        "--seconds",
        type=positive("s"),
        default=SECONDS,
        metavar="S",
        help="length of the run in rig time (default: %(default)g)",
    )
    parser.add_argument(
        "--seed",
        type=int,
        metavar="N",
        help="seed of the instruments' noise and calibration errors (default: as configured; not for a running rig)",
    )
    parser.add_argument(
        "--scan-rate",
        type=int,
        metavar="HZ",
        help="scans per second, in blocks of about 10 ms (default: as configured; not for a running rig)",
    )
    add_rig(parser)
    add_output(parser, "new or empty directory of the run (default: runs/record_<time>)")
    add_json(parser)


def add_info(commands: Commands) -> None:
    """Register the command `impact-rig info` with its options."""
    parser = subcommand(
        commands,
        "info",
        "impact_rig.cli.recorded:run_info",
        "contents of a run, and whether it is complete",
        [
            ("info runs/demo/gap_6mm", "verdict, duration, topics"),
            ("info runs/demo/gap_6mm --json", "the same for a script"),
        ],
        "Exit code 0: every checksum fits and nothing is known to be missing; 1: otherwise.",
    )
    add_json(parser)
    parser.add_argument("path", type=Path, metavar="RUN", help="run directory or .mcap file")


WINDOWS = ("hann", "boxcar", "flattop", "blackmanharris")  # the first is the default
GROUP = "impact_rig.analyses"
"""Entry points through which packages contribute analyses, each an `Analysis`."""


class Analysis(NamedTuple):
    """Analysis of a recorded run that an option of `impact-rig analyze` selects instead of the usual one.

    Attributes:
        name: name of its option, without the dashes.
        add: function that adds the option, whose default must be None or False.
        run: function that analyses a run, prints the result and returns the exit code, as `module:function`. It is
            called with the console, the opened run and the parsed arguments.
    """

    name: str
    add: Callable[[argparse._MutuallyExclusiveGroup], object]
    run: str


def analyses() -> Iterator[Analysis]:
    """Return the analyses that installed packages, including this one, add to `impact-rig analyze`.

    Each analysis has an option of its own.
    """
    return (one.load() for one in metadata.entry_points(group=GROUP))


def add_analyze(commands: Commands) -> None:
    """Register the command `impact-rig analyze` with its options."""
    parser = subcommand(
        commands,
        "analyze",
        "impact_rig.cli.analyze:run_analyze",
        "analyse a run again like the live node, and compare the results",
        [
            ("analyze runs/demo/gap_6mm", "every measurement in it, and whether the live analysis found the same"),
            ("analyze runs/demo/gap_6mm --figures pictures", "also draws time traces, phase plane, spectrum, curves"),
            ("analyze runs/chirp --frf", "frequency response of a chirp, with lines as fine as its resonance needs"),
        ],
        "DT is the displacement transmissibility. Exit code 0: equal to the live analysis, or no live analysis to "
        "compare with, also if nothing was measured; 1: different, or not readable. With --sine or --drop 1 also means "
        "that the result is not valid.",
    )
    add_json(parser)
    parser.add_argument(
        "--all",
        action="store_true",
        help="also print measurements without a value of DT, with their status, which --json always contains; only for "
        "the usual analysis",
    )
    add_run(parser)
    instead = parser.add_argument_group("analyses instead of the usual one").add_mutually_exclusive_group()
    for analysis in analyses():
        analysis.add(instead)
    parser.add_argument(
        "--segment",
        type=float,
        metavar="S",
        help="length in seconds of the segments that --frf averages; the lines are 1/S Hz apart (default: as long as "
        "resolving the resonance needs, at most 2/5 of the record)",
    )
    parser.add_argument(
        "--window",
        choices=WINDOWS,
        help="window function of the segments of --frf; boxcar is for a drive that repeats every segment (default: "
        f"{WINDOWS[0]})",
    )
    parser.add_argument(
        "--damping",
        type=float,
        metavar="ZETA",
        help="damping ratio of the resonance, from which --frf finds the length of its segments and whether they "
        "resolve the peak (default: estimated from the record)",
    )
    add_figures(
        parser,
        "directory for figures of the last settled measurement (time traces, phase plane, spectrum) and of DT against "
        "frequency, or of the result of the chosen option",
    )


FRF = Analysis(
    "frf",
    lambda instead: instead.add_argument(
        "--frf",
        action="store_true",
        help="frequency response x_1/x_b (displacement of structure/base) of a run driven by a chirp or noise: H1, H2, "
        "Hv, coherence; a sine drive gives one line only",
    ),
    "impact_rig.cli.analyze:run_frf",
)


SINE = Analysis(
    "sine",
    lambda instead: instead.add_argument(
        "--sine",
        action="store_true",
        help="a sine of the drive frequency, fitted to each channel in the last settled measurement (without one, at "
        "the end of the run), and DT from it",
    ),
    "impact_rig.cli.analyze:run_sine",
)


def add_verify(commands: Commands) -> None:
    """Register the command `impact-rig verify` with its options."""
    parser = subcommand(
        commands,
        "verify",
        "impact_rig.cli.recorded:run_verify",
        "re-simulate a run from its journal and compare every recorded topic of the rig bit for bit",
        [("verify runs/demo/gap_6mm", "prints `identical` or the first difference, then a line per topic")],
        "Exit code 0: identical; 1: different, or not verifiable.",
    )
    add_run(parser)
    add_json(parser)


def add_replay(commands: Commands) -> None:
    """Register the command `impact-rig replay` with its options."""
    parser = subcommand(
        commands,
        "replay",
        "impact_rig.cli.recorded:run_replay",
        "publish the messages of a run on its topics again, with /clock",
        [
            ("replay runs/demo/gap_6mm", "in real time"),
            ("replay runs/demo/gap_6mm --rate max --peers analysis", "as fast as the analysis follows"),
        ],
        "The messages reach this machine only, unless ROS_AUTOMATIC_DISCOVERY_RANGE is set. Exit code 0: all messages "
        "were published; 1: not all were, for the printed reason.",
    )
    parser.set_defaults(needs_ros=lambda _: True)
    add_run(parser)
    parser.add_argument(
        "--rate",
        type=_rate,
        default=1.0,
        metavar="X",
        help="speed as a multiple of real time, from 0.001 to 1000; or max, only with --peers: as fast as these follow "
        "(default: 1)",
    )
    parser.add_argument(
        "--peers",
        nargs="+",
        default=[],
        metavar="NODE",
        help="nodes that acknowledge each block; the replay waits until all of them subscribe, and runs at most 16 "
        "blocks ahead of the slowest, so that they lose none. It fails if one acknowledges no outstanding block for "
        "10 s; required by --rate max",
    )
    parser.add_argument(
        "--topics",
        nargs="+",
        default=[],
        metavar="TOPIC",
        help="topics to publish, with or without namespace; with --peers, daq/scan must be one of them (default: all "
        "but those of other rigs). daq/ack and the recorded /clock are never published",
    )
    parser.add_argument(
        "--loop", action="store_true", help="replay the run, with the same stamps, again and again until Ctrl-C"
    )
    parser.add_argument(
        "--paused",
        action="store_true",
        help="start paused at the first scan; to go on, call the service /player/pause (std_srvs/SetBool) with data: "
        "false",
    )
    parser.add_argument(
        "--delay",
        type=_delay,
        default=1.0,
        metavar="S",
        help="seconds to wait once, before the first message, so that subscribers find the topics (default: 1)",
    )


FASTEST = "max"
LONGEST_DELAY_S = 3600.0


def _delay(text: str) -> float:
    return _number(text, 0.0, LONGEST_DELAY_S, "a number of seconds")


def _rate(text: str) -> float:
    return math.inf if text == FASTEST else _number(text, 0.001, 1000.0, f"{FASTEST} or a number")


def _number(text: str, least: float, most: float, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not least <= value <= most:
        raise argparse.ArgumentTypeError(f"must be {what} from {least:g} to {most:g}, got {text!r}")
    return value


INCOMPLETE = 3  # exit code if the new run lacks parts of the old one


def add_recover(commands: Commands) -> None:
    """Register the command `impact-rig recover` with its options."""
    parser = subcommand(
        commands,
        "recover",
        "impact_rig.cli.recorded:run_recover",
        "save every intact chunk of a damaged or unfinished run",
        [("recover runs/killed runs/saved", "writes the intact data to a new run, and lists what is missing")],
        f"Exit code 0: no damage was found, and all messages that were found are saved; {INCOMPLETE}: something is "
        "damaged or missing; 1: nothing was saved.",
    )
    parser.add_argument("path", type=Path, metavar="RUN", help="run directory or .mcap file")
    add_json(parser)
    parser.add_argument("out", type=Path, metavar="OUT", help="run directory to write, which must not exist yet")
    parser.add_argument(
        "--accept-unchecked",
        action="store_true",
        help="also save chunks, messages, attachments and metadata without a checksum; they may be damaged",
    )


def add_export(commands: Commands) -> None:
    """Register the command `impact-rig export` with its options."""
    parser = subcommand(
        commands,
        "export",
        "impact_rig.cli.export:run_export",
        "write a table of a run, campaign, map or study as .csv, .npz, .parquet or .uff",
        [
            ("export runs/demo/gap_6mm transmissibility/table dt.csv", "the measurements"),
            ("export runs/demo/gap_6mm daq/scan scans.npz", "every scan, for NumPy"),
            ("export runs/campaign_paper points curves.uff", "curves as a universal file (dataset 58)"),
            ("export runs/dynamics_nominal bifurcation rows.csv", "the rows of a study of dynamics"),
        ],
    )
    add_run(parser, "a run, or the directory of a campaign, a map or studies of dynamics")
    parser.add_argument(
        "topic",
        help="table to write: for a run a topic, e.g. transmissibility/table; for a campaign or a map: points; for "
        "dynamics: the kind of study",
    )
    parser.add_argument(
        "target",
        type=Path,
        metavar="FILE",
        help="new file to write; its suffix selects the format: .csv, .npz, .parquet or .uff",
    )


def add_fmu(commands: Commands) -> None:
    """Register the command `impact-rig fmu` with its options."""
    parser = subcommand(
        commands,
        "fmu",
        "impact_rig.cli.fmu:run_fmu",
        "write the rig as a co-simulation unit (FMI 3.0 or 2.0)",
        [
            ("fmu rig.fmu", "the paper's rig, for FMI 3.0"),
            ("fmu --config my_rig.yaml --fmi 2.0 my_rig.fmu", "another rig, for tools that know FMI 2.0"),
        ],
    )
    parser.add_argument("path", type=Path, metavar="OUT.fmu", help="file to write; an existing one is replaced")
    add_config(
        parser,
        "configuration of the rig to write; values not in FILE are those of the paper's rig (default: the paper's rig)",
    )
    parser.add_argument("--fmi", choices=VERSIONS, default=VERSIONS[0], help="version of FMI (default: %(default)s)")
    parser.add_argument(
        "--kernels",
        type=Path,
        metavar="DIR",
        help="folder of kernels compiled for another machine, on which the FMU is to run; docs/how-to/fmu.md shows how "
        "to compile them (default: the kernels of this package)",
    )


PORT = 31763  # port of the NI gRPC Device Server


def add_daqmx(commands: Commands) -> None:
    """Register the command `impact-rig daqmx` with its options."""
    parser = subcommand(
        commands,
        "daqmx",
        "impact_rig.cli.daqmx:run_daqmx",
        "serve the rig to scripts that use NI's nidaqmx package",
        [
            ("daqmx", "a simulated rig as Dev1, on this machine only"),
            ("daqmx --config my_rig.yaml --device cDAQ1Mod1 cDAQ1Mod2", "another rig, named as in a script"),
            ("daqmx --namespace /rig", "a rig that already runs in real time with drive.waveform: stream"),
        ],
        "See docs/how-to/daqmx.md: a script connects through the option grpc_options of its tasks. The command runs "
        "until Ctrl-C; its exit code is then 0.",
    )
    parser.set_defaults(ends_by_signal=True, needs_ros=lambda arguments: bool(arguments.namespace))
    add_config(
        parser,
        "configuration of the rig to simulate, not with --namespace; values not in FILE are those of the paper's rig "
        "(default: the paper's rig)",
    )
    parser.add_argument(
        "--namespace",
        help="namespace of a running rig for scripts to use; in its own configuration, time.mode must be realtime and "
        "drive.waveform stream; not with --config (default: this program simulates a rig)",
    )
    parser.add_argument(
        "--device",
        nargs="+",
        default=["Dev1"],
        metavar="NAME",
        help="device names by which scripts may address the board (default: Dev1)",
    )
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help="address on which the server listens; unless it is a loopback address, other machines can drive the rig "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--port",
        type=int,
        default=PORT,
        help="port on which the server listens; 0: any free one (default: %(default)s)",
    )


def add_check(commands: Commands) -> None:
    """Register the command `impact-rig check` with its options."""
    parser = subcommand(
        commands,
        "check",
        "impact_rig.cli.check:run_check",
        "validate a configuration file without starting anything",
        [
            ("check config/nominal.yaml", "prints that it is valid, or key, value, range and file of a mistake"),
            ("check my_rig.yaml --instruments", "also applies a known sine to every channel"),
        ],
        "Exit code 0: the file is valid, and no channel fails the check of --instruments; 1: otherwise.",
    )
    parser.add_argument("path", type=Path, metavar="FILE", help="configuration of the rig, as YAML")
    add_json(parser)
    parser.add_argument(
        "--instruments",
        action="store_true",
        help="also check gain, phase, noise and polarity of each simulated channel with a known sine",
    )


def add_interface(commands: Commands) -> None:
    """Register the command `impact-rig interface` with its options."""
    parser = subcommand(
        commands,
        "interface",
        "impact_rig.cli.interface:run_interface",
        "list topics, services and parameters, or what changed from an earlier version",
        [
            ("interface --json > interface.json", "types, qualities of service, columns, ranges, defaults"),
            ("interface --against older.json", "changes that break a client of that version, and additions"),
        ],
        "Exit code 1 if a change breaks clients of the earlier version, or FILE cannot be read; "
        "docs/reference/interface.md lists the kinds of such changes.",
    )
    add_json(
        parser,
        "print as JSON: the whole interface, with columns, ranges and defaults, instead of a table of topics and "
        "services; with --against, the changes",
    )
    parser.add_argument(
        "--against",
        type=Path,
        metavar="FILE",
        help="output of `interface --json` of an earlier version: list what has changed since then; the exit code is 1 "
        "if a change breaks clients",
    )
