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
"""Options of the commands for studies; the module that executes a command is imported only when the command runs."""

from __future__ import annotations

import argparse
from pathlib import Path

import attrs

from impact_rig.cli.options import (
    PROCESS,
    ROS,
    Commands,
    add_config,
    add_figures,
    add_json,
    add_output,
    add_recorded_rig,
    add_rig,
    add_run,
    subcommand,
)
from impact_rig.cli.parsers import Analysis
from impact_rig.cli.quantities import GAP, Quantity, add_field, positive
from impact_rig.config import FieldInfo
from impact_rig.config.sections import Daq
from impact_rig.errors import ConfigError
from impact_rig_studies.dynamics import KINDS
from impact_rig_studies.excitation import signals
from impact_rig_studies.identification import U_RESTITUTION
from impact_rig_studies.operate.plans import Hold, HoldPlan, LockPlan, SweepPlan


def add_demo(commands: Commands) -> None:
    """Register the command `impact-rig demo` with its options."""
    parser = subcommand(
        commands,
        "demo",
        "impact_rig_studies.cli.demo:run_demo",
        "measure the paper's five reductions of displacement transmissibility DT with a rig, an analysis and a "
        "recorder as ROS processes",
        [
            ("demo", "three processes, six runs recorded below runs/, a table and a figure"),
            ("demo --scan-rate 50000 --seed 7 --output runs/fast", "other calibration errors, more scans per second"),
        ],
        "--output must be new or empty. The last line is the directory of the results. Exit code 0: every reduction "
        "differs from the paper's by at most 3 percentage points, the reductions grow with the gap, DT without sphere "
        "agrees with theory within 2 %, and no block of scans was lost; 1: a check failed, which is named.",
    )
    parser.set_defaults(needs_ros=lambda _: True)
    add_json(parser)
    add_output(parser, "new or empty directory for runs, figure and summary (default: runs/demo_<time>)")
    parser.add_argument(
        "--scan-rate", type=int, default=Daq().rate_hz, metavar="HZ", help="scans per second (default: %(default)s)"
    )
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="seed of noise and calibration errors (default: 1)"
    )


def add_compare(commands: Commands) -> None:
    """Register the command `impact-rig compare` with its options."""
    parser = subcommand(
        commands,
        "compare",
        "impact_rig_studies.cli.compare:run_compare",
        "compare a measurement with the model driven in the same way, and fit the model's constants",
        [
            ("compare runs/mine --config my_rig.yaml", "the model of that rig, driven by the measured current"),
            ("compare runs/mine --drive base --figures build/mine", "driven by the measured base, with a figure"),
        ],
        "Works with recorded and imported runs: docs/tutorials/own_measurement.md. Exit code 0: compared, whether they "
        "agree or not; 1: not possible, for example because no measurement of the displacement transmissibility DT "
        "settled.",
    )
    add_json(parser)
    add_run(parser)
    add_config(parser, "configuration of the model (default: that stored in the run, else the paper's rig)")
    parser.add_argument(
        "--drive",
        choices=("current", "base"),
        help="measured quantity that drives the model: coil current, or motion of the inferior base (default: current "
        "if it was measured, else base)",
    )
    add_figures(parser, "directory for a figure of model and measurement (default: no figure)")
    parser.add_argument(
        "--no-fit", action="store_true", help="skip the search for the model's constants that fit the measurement best"
    )


FREQUENCY = Quantity(FieldInfo("Frequency of the drive.", "Hz", low=0.0), names=True)
GAP_LABEL = attrs.evolve(GAP, names=True)


def add_import(commands: Commands) -> None:
    """Register the command `impact-rig import` with its options."""
    parser = subcommand(
        commands,
        "import",
        "impact_rig_studies.cli.measurement:run_import",
        "import a measurement of your own rig as a run, or several as a campaign",
        [
            ("import test.csv --output runs/mine --dry-run", "shows the assignment of the columns, and writes nothing"),
            ("import test.csv --output runs/mine --channel laser=ai0 mm --gap 6mm", "column ai0 is the laser, in mm"),
            (
                'import two.tdms --output runs/two --channel base="ai0 V, 100 mV/g"',
                "column ai0 is an accelerometer on the base, in volts, with its sensitivity",
            ),
            ("import sweep/*.mat --output runs/my_sweep --campaign", "frequency and gap of each point in a file name"),
        ],
        "Reads text tables (CSV, TSV, LVM), TDMS, universal files (dataset 58), MATLAB, WAV, Parquet, npz, "
        "Rattlesnake netCDF4 and ROS bags. Each file becomes one run: in DIR itself, in DIR/NAME if there are several "
        "files, or in DIR/runs/NAME with --campaign. DT, the displacement transmissibility, needs laser (motion of the "
        "structure) and base (motion below the structure), each as displacement, velocity or acceleration; without "
        "them the run has no DT: docs/tutorials/own_measurement.md. Exit code 1: a file was rejected, and nothing was "
        "written.",
    )
    add_json(parser)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="measurement in one of the formats below")
    parser.add_argument(
        "--output",
        type=Path,
        required=True,
        metavar="DIR",
        help="new or empty directory for the run or the campaign; for several runs, any directory, in which each gets "
        "a new folder (required)",
    )
    parser.add_argument(
        "--dry-run", action="store_true", help="show how the files would be imported, and write nothing"
    )
    parser.add_argument(
        "--mapping",
        type=Path,
        metavar="YAML",
        help="YAML file that assigns the signals to channels, with units and calibration (default: guessed from names "
        "and units); other options take precedence over it",
    )
    parser.add_argument(
        "--channel",
        action="append",
        nargs="+",
        default=[],
        metavar="NAME=SIGNAL",
        help="signal of the file to use as a channel (laser, base, accelerometer or current), with unit and "
        "sensitivity if the file has none: laser=ai0, laser='ai0 mm', laser='ai0 V, 500 mV/mm'. An empty signal, "
        "as in laser=, leaves the channel out. Channels that are not named stay as in --mapping or guessed; repeatable",
    )
    parser.add_argument(
        "--scan-rate",
        type=float,
        metavar="HZ",
        help="scans per second; the file's rate and times are then ignored (default: the file's rate or times)",
    )
    parser.add_argument(
        "--resample",
        type=int,
        metavar="HZ",
        help="scans per second at which splines interpolate all signals, for files whose times are not uniform or "
        "differ between signals; at least the (median) rate of the file (default: such files are rejected)",
    )
    parser.add_argument(
        "--frequency",
        type=FREQUENCY,
        metavar="HZ|SIGNAL",
        help="drive frequency, e.g. 9.1Hz, or the name of its signal. Default: the signal `frequency`, else the "
        "frequency in the file name if the data do not contradict it, else the strongest one in the base's motion, "
        "or without it in the first of current, laser and accelerometer",
    )
    parser.add_argument(
        "--gap",
        type=GAP_LABEL,
        metavar="LENGTH|SIGNAL",
        help="gap with its unit, e.g. 6mm, none (no sphere), or the name of its signal, in m unless the file "
        "states its unit (default: the signal `gap`, else from the file name, else unknown)",
    )
    parser.add_argument(
        "--commands",
        type=Path,
        metavar="FILE",
        help="table of the drive commands, with the columns time [s] or stamp_ns, frequency [Hz] and, if known, "
        "current [A peak], used instead of --frequency. Default: one at each change of the frequency signal, or else "
        "one at the first scan with the frequency of --frequency or its default",
    )
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="FILE",
        help="table of the instruments' calibration: columns of daq/info, one row per channel (default: resolution "
        "and skew estimated from the data; no noise, errors or delay, and unlimited range)",
    )
    parser.add_argument(
        "--note", action="append", default=[], metavar="TEXT", help="remark for each run (default: none); repeatable"
    )
    parser.add_argument(
        "--campaign", action="store_true", help="combine the runs into one campaign, for report and identify"
    )
    add_config(
        parser,
        "with --campaign: rig configuration whose sphere, barriers and contact law `identify` takes as known, except "
        "that it fits e near its nominal value, and whose constants start the fit (default: the paper's rig)",
    )


def add_drive(commands: Commands) -> None:
    """Register the command `impact-rig drive` with a subcommand for each of its tests, in the order of the help."""
    parser = subcommand(
        commands,
        "drive",
        None,
        "drive a rig: signals, sine sweeps, controlled amplitudes, resonances, shocks",
        [
            ("drive play road.csv --signal drive --scale 0.5", "half of a column as the current"),
            ("drive sweep --gap 6mm", "DT over the frequency at a constant current"),
            ("drive hold base 60um --frequencies 8.8 9.1 9.4", "the base at 60 µm, at three frequencies"),
            ("drive lock --gap none", "find the resonance without a sphere, and track it"),
            ("drive random --gap none", "a power spectral density of the base's acceleration, 5 to 200 Hz"),
        ],
        "`impact-rig drive TEST --help` shows the options of a test. DT is the displacement transmissibility. Each "
        "test writes its results to a new or empty directory, whose name is the last line of its output.",
    )
    tests = parser.add_subparsers(dest="test", required=True, metavar="TEST", help="kind of test")
    for add in (
        _add_play, _add_frf, _add_hold, _add_sweep, _add_lock,
        _add_backbone, _add_random, _add_replicate, _add_shock,
    ):  # fmt: skip
        add(tests)


STREAM_ENDING = (
    "Exit code 0: the test ran to its end and has a result; 1: it ended early or has no result. The drive, also that "
    "of a running rig, ramps to zero at the end."
)
RATE_HZ, FAST_HZ = 2_000, 10_000  # default rates of samples and scans: enough for 200 Hz, and for a shock
PLAN = "file with the settings of the test, e.g. config/excitation/{}.yaml (default: {})"
EXCITATION = {name: name for name in ("kind", "frames", "frame_s", "low_hz", "high_hz", "rms")} | {"drive_seed": "seed"}
"""Option of `drive frf` -> attribute of `signals.Excitation` that it sets."""


SI = {"accelerometer": "(m/s²)", "laser": "m", "base": "m", "current": "A"}


def _add_play(tests: Commands) -> None:
    """Register the test `impact-rig drive play` with its options."""
    parser = subcommand(
        tests,
        "play",
        "impact_rig_studies.cli.drive_stream:run_play",
        "drive the rig with a signal of a file or of a run",
        [
            ("drive play road.csv --signal drive --scale 0.5", "half of a column, resampled to the rig's rate"),
            ("drive play runs/demo/gap_6mm --seconds 30", "the measured current of a recorded run"),
        ],
        STREAM_ENDING,
    )
    _add_signal(parser, "current")
    parser.add_argument(
        "--seconds", type=positive("s"), metavar="S", help="rig time after which the signal ends (default: all of it)"
    )
    parser.add_argument(
        "--clip",
        type=positive("A"),
        metavar="A",
        help="absolute current to which larger samples are clipped (default: a sample above the shaker's limit ends "
        "the test)",
    )
    _add_stream_options(parser, "play", FAST_HZ)


def _add_frf(tests: Commands) -> None:
    """Register the test `impact-rig drive frf` with its options."""
    default = signals.Excitation()
    parser = subcommand(
        tests,
        "frf",
        "impact_rig_studies.cli.drive_stream:run_frf",
        "measure a frequency response with random noise or a chirp",
        [
            ("drive frf --gap none", "base over current, with bursts of noise"),
            ("drive frf --response laser --reference base --kind chirp", "structure over base"),
        ],
        f"{STREAM_ENDING} A response that is only noise is no result.",
    )
    parser.add_argument(
        "--kind", choices=signals.KINDS, default=default.kind, help=f"signal of the drive (default: {default.kind})"
    )
    parser.add_argument(
        "--response",
        choices=tuple(SI),
        default="base",
        help="channel of the response, which is divided by that of --reference (default: base)",
    )
    parser.add_argument(
        "--reference", choices=tuple(SI), default="current", help="channel of the reference (default: current)"
    )
    for option, metavar, text in (
        ("frames", "N", "number of frames to average"),
        ("frame_s", "S", "length of a frame in s"),
        ("low_hz", "HZ", "lower edge of the excited band"),
        ("high_hz", "HZ", "upper edge of the excited band"),
        ("rms", "A", "RMS current of the drive in A while it is on"),
        ("drive_seed", "N", "seed of the drive's random numbers"),
    ):
        value = getattr(default, EXCITATION[option])
        parser.add_argument(
            f"--{option.replace('_', '-')}",
            type=type(value),
            default=value,
            metavar=metavar,
            help=f"{text} (default: {value})",
        )
    _add_stream_options(parser, "frf", RATE_HZ)


def _add_random(tests: Commands) -> None:
    """Register the test `impact-rig drive random` with its options."""
    parser = subcommand(
        tests,
        "random",
        "impact_rig_studies.cli.drive_stream:run_random",
        "shake the rig with random noise, corrected until a response has a requested power spectral density",
        [("drive random --gap none", "a power spectral density of the base's acceleration, 5 to 200 Hz")],
        STREAM_ENDING,
    )
    parser.add_argument(
        "plan", nargs="?", type=Path, metavar="FILE", help=PLAN.format("random", "the base's acceleration, 5 to 200 Hz")
    )
    _add_stream_options(parser, "random", RATE_HZ)


def _add_replicate(tests: Commands) -> None:
    """Register the test `impact-rig drive replicate` with its options."""
    parser = subcommand(
        tests,
        "replicate",
        "impact_rig_studies.cli.drive_stream:run_replicate",
        "make a motion of the rig follow a given signal, by learning from repeated trials",
        [("drive replicate road.csv --signal x_b --unit mm", "the motion of the base follows the column x_b")],
        STREAM_ENDING,
    )
    _add_signal(parser, "the one that measures the controlled motion")
    parser.add_argument(
        "--plan",
        type=Path,
        metavar="FILE",
        help=PLAN.format("replicate", "the inferior base follows the signal, 2 to 150 Hz, at most 20 trials"),
    )
    _add_stream_options(parser, "replicate", RATE_HZ)


def _add_shock(tests: Commands) -> None:
    """Register the test `impact-rig drive shock` with its options."""
    parser = subcommand(
        tests,
        "shock",
        "impact_rig_studies.cli.drive_stream:run_shock",
        "make the base follow a compensated half sine, by learning from repeated trials",
        [("drive shock", "20 m/s², 11 ms")],
        STREAM_ENDING,
    )
    parser.add_argument("plan", nargs="?", type=Path, metavar="FILE", help=PLAN.format("shock", "20 m/s², 11 ms"))
    _add_stream_options(parser, "shock", FAST_HZ)


def _add_signal(parser: argparse.ArgumentParser, channel: str) -> None:
    parser.add_argument(
        "file",
        type=Path,
        metavar="FILE",
        help="file with the signal, in a format that `import` reads, or a run; the signal is resampled to --scan-rate",
    )
    parser.add_argument(
        "--signal",
        metavar="NAME",
        help=f"column of the file (default: its only one), or channel of the run (default: {channel})",
    )
    parser.add_argument(
        "--unit",
        default="",
        metavar="UNIT",
        help="unit of a file's values, not for a run (default: the unit in the file, else the SI unit of the played "
        "current or the replicated motion)",
    )
    parser.add_argument(
        "--scale",
        type=float,
        default=1.0,
        metavar="X",
        help="factor by which the values of the signal are multiplied, in addition to the conversion of their unit "
        "(default: 1)",
    )
    parser.add_argument(
        "--file-rate",
        type=float,
        metavar="HZ",
        help="samples per second of a file without times and without a rate; else not allowed",
    )


def _add_stream_options(parser: argparse.ArgumentParser, test: str, rate_hz: int) -> None:
    add_rig(
        parser,
        needs=". A running rig needs drive.waveform: stream, and its daq.rate_hz and drive.stream_rate_hz must both "
        "equal --scan-rate",
    )
    parser.add_argument(
        "--scan-rate",
        type=int,
        default=rate_hz,
        metavar="HZ",
        help="scans per second, and samples per second of the drive; for a running rig, state its rate (default: "
        f"{rate_hz})",
    )
    parser.add_argument(
        "--abort",
        nargs="+",
        type=_limit,
        default=[],
        metavar="CHANNEL=X",
        help="limits of channels; a larger absolute reading ends the test, e.g. laser=5mm current=2A; a length "
        "needs its unit; without a unit, a current is in A and an acceleration in m/s^2 (default: none)",
    )
    add_output(parser, f"new or empty directory of the results (default: runs/{test}_<time>)")
    add_json(parser)


def _limit(text: str) -> tuple[str, float]:
    channel, _, value = text.partition("=")
    if channel not in SI:
        raise argparse.ArgumentTypeError(f"the channel must be one of {', '.join(SI)}, as in laser=5mm, got {text!r}")
    try:
        return channel, positive(SI[channel].strip("()")).number(value)
    except ConfigError as error:
        raise argparse.ArgumentTypeError(f"{channel}: {error}") from error


def _add_hold(tests: Commands) -> None:
    """Register the test `impact-rig drive hold` with its options."""
    parser = subcommand(
        tests,
        "hold",
        "impact_rig_studies.cli.drive_sine:run_hold",
        "step the frequency at a controlled amplitude",
        [("drive hold base 60um --frequencies 8.8 9.1 9.4", "the base at 60 µm, at three frequencies")],
        "Exit code 0: DT was measured at each frequency, with the amplitude within the tolerance; 1: otherwise.",
    )
    parser.add_argument(
        "what",
        choices=[*Hold],
        help="quantity whose amplitude is controlled: coil current, or motion of the inferior or superior base",
    )
    parser.add_argument(
        "target", metavar="PEAK", help="peak amplitude to hold, with its unit: 60um of a base, or 0.5A of the current"
    )
    _add_points(parser)
    add_field(parser, attrs.fields(HoldPlan).tolerance, "X")
    current = attrs.fields(SweepPlan).current_a
    parser.add_argument(
        "--current",
        type=Quantity.of(current),
        default=current.default,
        metavar="A",
        help="peak amplitude of the drive with which the control starts: a current, or by drive.kind a displacement "
        "in m or a voltage in V (default: %(default)s, meant for a current)",
    )
    _add_sine_options(parser, "hold")


def _add_sweep(tests: Commands) -> None:
    """Register the test `impact-rig drive sweep` with its options."""
    parser = subcommand(
        tests,
        "sweep",
        "impact_rig_studies.cli.drive_sine:run_sweep",
        "step the frequency at a constant current",
        [("drive sweep --gap 6mm --direction up_down", "DT over the frequency, upwards and downwards")],
        "Exit code 0: DT was measured at each frequency; 1: otherwise.",
    )
    _add_points(parser)
    _add_current(parser)
    _add_sine_options(parser, "sweep")


def _add_lock(tests: Commands) -> None:
    """Register the test `impact-rig drive lock` with its options."""
    lock = attrs.fields(LockPlan)
    parser = subcommand(
        tests,
        "lock",
        "impact_rig_studies.cli.drive_sine:run_lock",
        "find a resonance, track it, and dwell there",
        [("drive lock --gap none", "the resonance without a sphere")],
        f"The frequency stays between {lock.low_hz.default:g} and {lock.high_hz.default:g} Hz. The test ends early "
        f"if no resonance is found within {lock.seek_limit_s.default:g} s of rig time. Exit code 0: a resonance was "
        "tracked until the end; 1: otherwise, with the reason.",
    )
    add_field(parser, lock.dwell_s, "S", "--dwell")
    _add_search(parser)
    _add_current(parser)
    _add_sine_options(parser, "lock")


def _add_backbone(tests: Commands) -> None:
    """Register the test `impact-rig drive backbone` with its options."""
    parser = subcommand(
        tests,
        "backbone",
        "impact_rig_studies.cli.drive_sine:run_backbone",
        "find the resonance at each of several currents, in ascending and then in descending order",
        [("drive backbone --currents 0.1 0.2 0.4", "frequency and amplitude of the resonance at three currents")],
        "Exit code 0: the test ran to its end; 1: it ended early, with the reason.",
    )
    parser.add_argument(
        "--currents",
        type=float,
        nargs="+",
        required=True,
        metavar="A",
        help="peak amplitudes of the drive in A (m or V by drive.kind), above 0 and in ascending order, e.g. 0.1 0.2 "
        "0.4; they are measured upwards and then downwards, the largest once (required)",
    )
    _add_search(parser)
    _add_sine_options(parser, "backbone")


def _add_points(parser: argparse.ArgumentParser) -> None:
    plan = attrs.fields(SweepPlan)
    add_field(parser, plan.frequencies_hz, "HZ", "--frequencies")
    add_field(parser, plan.direction)
    add_field(parser, plan.measurements_per_point, "N", "--measurements")


def _add_search(parser: argparse.ArgumentParser) -> None:
    add_field(parser, attrs.fields(LockPlan).start_hz, "HZ", "--start")
    add_field(parser, attrs.fields(LockPlan).reference)


def _add_current(parser: argparse.ArgumentParser) -> None:
    add_field(parser, attrs.fields(SweepPlan).current_a, "A", "--current")


def _add_sine_options(parser: argparse.ArgumentParser, test: str) -> None:
    add_rig(parser, (PROCESS, ROS))
    add_json(parser)
    add_output(parser, f"new or empty directory of the results (default: runs/{test}_<time>)")


def add_campaign(commands: Commands) -> None:
    """Register the command `impact-rig campaign` with its options."""
    parser = subcommand(
        commands,
        "campaign",
        "impact_rig_studies.cli.campaign:run_campaign",
        "measure all points of a campaign file; run again to resume",
        [
            ("campaign config/paper.yaml", "the whole paper, on all cores"),
            ("campaign config/paper.yaml --only curves --check", "its curves, 60 points; exit code 1 if a check fails"),
            ("campaign my.yaml --through ros --record --output runs/mine", "with ROS nodes, and recordings"),
        ],
        "The last line is the directory of the results; `impact-rig report` makes a page of it. Exit code 0, also if "
        "points failed, unless --check is given; 1 after an error.",
    )
    parser.set_defaults(needs_ros=lambda arguments: arguments.through[0] == ROS)
    _add_tasks(parser, "campaign", "campaign", "config/paper.yaml", ", ros (rig and analysis as ROS nodes)")
    parser.add_argument(
        "--only", nargs="+", default=(), metavar="STUDY", help="studies of FILE to measure (default: all)"
    )
    parser.add_argument(
        "--seed",
        type=int,
        metavar="N",
        help="seed of noise and calibration errors (default: that of the rig defined in FILE)",
    )
    parser.add_argument(
        "--scan-rate", type=int, metavar="HZ", help="scans per second (default: those of the rig defined in FILE)"
    )
    parser.add_argument(
        "--record", action="store_true", help="record every newly measured run as MCAP (only with --through ros)"
    )
    parser.add_argument(
        "--check",
        action="store_true",
        help="exit with 1 if a point has no settled measurement, one of the paper's statements does not hold, or the "
        "reductions differ from the paper's by more than the printed limits",
    )


def add_report(commands: Commands) -> None:
    """Register the command `impact-rig report` with its options."""
    parser = subcommand(
        commands,
        "report",
        "impact_rig_studies.cli.campaign:run_report",
        "write the report of a campaign or a run: one HTML page, figures as PNG, SVG and PDF, numbers as JSON",
        [
            ("report runs/campaign_paper", "writes runs/campaign_paper/report.html"),
            ("report runs/demo/gap_6mm", "one run: result, uncertainty, conditions, motion"),
            ("report runs/campaign_paper --margins runs/campaign_margins", "with sensitivities to constants"),
        ],
        "The last line is the path of report.html. Exit code 0: written, whatever the results are.",
    )
    parser.add_argument("directory", type=Path, metavar="DIR", help="directory of a campaign, or a run")
    add_output(parser, "directory for report.html and report.json (default: that of the campaign or run)")
    parser.add_argument(
        "--margins",
        type=Path,
        metavar="DIR",
        help="campaign with varied constants (config/campaigns/margins.yaml), for the sensitivity of the "
        "paper's statements; only for a simulated campaign (default: the reported campaign)",
    )
    parser.add_argument(
        "--branches",
        type=Path,
        metavar="DIR",
        nargs="+",
        default=(),
        help="output directories of `impact-rig dynamics continue` for the campaign's rig; each adds a figure of its "
        "branches with the measured points (only for a simulated campaign)",
    )
    add_figures(parser, "directory for the figures (default: `figures` next to the page)")
    add_recorded_rig(
        parser,
        "namespace of the rig to read if DIR is a run; required if it has several (default: the only one)",
    )


def add_map(commands: Commands) -> None:
    """Register the command `impact-rig map` with its options."""
    parser = subcommand(
        commands,
        "map",
        "impact_rig_studies.cli.mechanics:run_map",
        "compute displacement transmissibility DT and regimes of the model over two or three parameters; run again to "
        "resume",
        [
            ("map config/maps/gap_frequency.yaml", "on all cores; writes a table and draws the map"),
            ("map my_map.yaml --through dask tcp://host:8786", "on a Dask cluster"),
        ],
        "Exit code 0: the motion could be simulated at one point or more; 1: at none.",
    )
    _add_tasks(parser, "map", "map", "config/maps/gap_frequency.yaml")
    _add_drawings(parser)
    parser.add_argument(
        "--exponent",
        action="store_true",
        help="compute the largest Lyapunov exponent of every motion that is not periodic, for the table map.csv; "
        "only for a map whose direction is reset",
    )


def add_dynamics(commands: Commands) -> None:
    """Register the command `impact-rig dynamics` with its options."""
    parser = subcommand(
        commands,
        "dynamics",
        "impact_rig_studies.cli.mechanics:run_dynamics",
        "compute Poincaré sections, bifurcations, basins, orbits, branches or Lyapunov exponents of the model",
        [
            ("dynamics continue config/dynamics/nominal.yaml", "stable and unstable motions over the gap, with folds"),
            ("dynamics basin config/dynamics/two_motions.yaml", "the motion reached from each start of the sphere"),
        ],
        more="All studies use the mechanics without instruments. Run the command again to resume it. Exit code 0: one "
        "row or more has a result; 1: none has, because no motion could be simulated or no orbit was found.",
    )
    parser.add_argument("kind", choices=KINDS, help="kind of study, which is also the section of the file to use")
    _add_tasks(parser, "dynamics", "studies", "config/dynamics/nominal.yaml")
    _add_drawings(parser)


def _add_tasks(parser: argparse.ArgumentParser, command: str, what: str, example: str, other_way: str = "") -> None:
    """Add the arguments that `campaign`, `map` and `dynamics` share, which `impact_rig_studies.cli.tasks` reads.

    Args:
        parser: parser of the command.
        command: name of the command, also the first word of the default directory.
        what: subject of the file, for the help.
        example: path of a file that comes with the package, for the help.
        other_way: part of the help of `--through` that names a further way of measuring, with a leading comma, such as
            `, ros (rig and analysis as ROS nodes)`; empty if there is none.
    """
    parser.add_argument(
        "file",
        nargs="?",
        type=Path,
        metavar="FILE",
        help=f"file that defines the {what} (required), e.g. {example}; it may also follow --through WAY",
    )
    parser.add_argument(
        "--through",
        nargs="+",
        default=[PROCESS],
        metavar="WAY",
        help=f"way of measuring: process (on all cores of this machine; default){other_way} or dask ADDRESS (a Dask "
        "cluster)",
    )
    add_output(
        parser,
        "directory of the results; only those missing in it are computed, also after a change of the file, in which "
        f"the rig must stay the same (default: runs/{command}_NAME for a file NAME.yaml)",
    )
    parser.add_argument(
        "--workers",
        type=int,
        metavar="N",
        help="number of processes, of effect only with --through process (default: one per core)",
    )
    add_json(parser)


def _add_drawings(parser: argparse.ArgumentParser) -> None:
    """Add the options for the figures of `map` and `dynamics`."""
    parser.add_argument("--no-figures", action="store_true", help="draw no figures; earlier ones stay")
    add_figures(parser, "directory for the figures (default: `figures` in that of the results)")


def add_identify(commands: Commands) -> None:
    """Register the command `impact-rig identify` with its options."""
    parser = subcommand(
        commands,
        "identify",
        "impact_rig_studies.cli.identify:run_identify",
        "determine f_n, ζ, m_1 and e of the structure and K_f, k_f, M, c_f of the shaker from measured runs",
        [
            ("identify runs/campaign_paper", "from its curves, its reductions and a free decay"),
            ("identify --paper", "what the paper's own numbers determine"),
        ],
        "Writes identification.json into DIR, and identified.yaml, a configuration with the constants, if the data "
        "determine all of them and the model explains the data; else it removes that of an earlier fit. Exit code 0, "
        "whether identified.yaml was written or not.",
    )
    add_json(parser)
    parser.add_argument(
        "directory",
        nargs="?",
        type=Path,
        metavar="DIR",
        help="directory of a measured campaign, to which constants are fitted; the results are written into it "
        "(required without --paper)",
    )
    parser.add_argument(
        "--decay",
        type=Path,
        metavar="RUN",
        help="recorded free decay after a pluck (default: pluck the simulated rig; none for an imported campaign)",
    )
    add_recorded_rig(
        parser,
        "namespace of the rig to read from the run of --decay; required if several are in it (default: the only one)",
    )
    parser.add_argument(
        "--decrement",
        action="store_true",
        help="evaluate the free decay, simulated or of --decay, by its logarithmic decrement instead of a fit",
    )
    parser.add_argument(
        "--without",
        nargs="+",
        choices=("decay", "sine", "reductions"),
        default=(),
        metavar="DATA",
        help="data not to use: decay (free decay), sine (displacement transmissibility DT without sphere), "
        "reductions (DT with the sphere)",
    )
    parser.add_argument(
        "--e-uncertainty",
        type=float,
        default=U_RESTITUTION,
        metavar="U",
        help="standard uncertainty of the configured restitution e, 0 if e is exact (default: %(default)g)",
    )
    parser.add_argument(
        "--paper",
        action="store_true",
        help="fit constants to the paper's reductions of DT instead of to a campaign, without DIR",
    )
    add_config(
        parser, "only with --paper: configuration with the constants that are not fitted (default: the paper's rig)"
    )


HEIGHT_UNCERTAINTY = Quantity(FieldInfo("Standard uncertainty of a height.", "m", low=0.0))


def _add_drop(instead: argparse._MutuallyExclusiveGroup) -> None:
    instead.add_argument(
        "--drop",
        type=HEIGHT_UNCERTAINTY,
        metavar="LENGTH",
        help="coefficient of restitution from drop tests noted as remarks like `drop h0_m=0.2 h1_m=0.0245` (heights of "
        "drop and rebound); LENGTH is the standard uncertainty of each height, e.g. 0.5mm",
    )


DROP = Analysis("drop", _add_drop, "impact_rig_studies.cli.drops:run_drop")
