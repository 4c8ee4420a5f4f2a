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
"""Tests of the command `impact-rig drive` that stream samples: play, frf, random, replicate and shock."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterator
from typing import TypeVar

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.cli.options import running_namespace
from impact_rig.cli.rig_options import open_rig, rig_of, run_directory
from impact_rig.cli.terminal import Console, tell_results
from impact_rig.driver.hardware import Hardware
from impact_rig.errors import CommandError, ConfigError, ImpactRigError
from impact_rig.names import visible
from impact_rig.rig.config import from_flat
from impact_rig.rig.gaps import case_of
from impact_rig.system import files
from impact_rig.system.endings import defer_signals
from impact_rig_studies.cli.parsers import EXCITATION, SI

P = TypeVar("P", bound=attrs.AttrsInstance)
Work = Callable[[Hardware], Iterator[object]]  # function that drives the rig, and yields its result so far repeatedly


def run_play(arguments: argparse.Namespace) -> int:
    """Drive the rig with a signal of a file or run, and return the exit code.

    The code is 1 if the test ended early or has no result, otherwise 0.
    """
    from impact_rig_studies.excitation.history import play  # noqa: PLC0415  # scipy

    samples = _history(arguments, "A")
    if arguments.seconds is not None and arguments.seconds * arguments.scan_rate < len(samples):
        samples = samples[: round(arguments.seconds * arguments.scan_rate)]
    if not len(samples):
        raise ConfigError(
            f"--seconds {arguments.seconds:g} is less than a sample at --scan-rate {arguments.scan_rate}: state "
            f"{1.0 / arguments.scan_rate:g} or more"
        )
    _refuse_zeros(arguments, samples)
    return _drive(
        arguments, f"Played: {visible(arguments.file.name)}", "A", lambda rig: play(rig, samples, arguments.clip)
    )


def _refuse_zeros(arguments: argparse.Namespace, samples: NDArray[np.float64]) -> None:
    if not samples.any():
        options = "--scale and --seconds" if "seconds" in arguments else "--scale"
        raise ConfigError(
            f"{arguments.file}: the signal is zero throughout, with {options} applied, so there is nothing to play or "
            f"to follow: change {options}, or choose another signal with --signal"
        )


def run_frf(arguments: argparse.Namespace) -> int:
    """Measure the frequency response of one channel to another with noise or a chirp, and return the exit code.

    The code is 1 if the test ended early or has no result, for example because noise hides the response; otherwise 0.
    """
    from impact_rig_studies.excitation.files import read  # noqa: PLC0415  # scipy
    from impact_rig_studies.excitation.response import measure  # noqa: PLC0415
    from impact_rig_studies.excitation.signals import Excitation  # noqa: PLC0415

    excitation = read({name: getattr(arguments, option) for option, name in EXCITATION.items()}, Excitation)
    title = f"Frequency response: {arguments.response} over {arguments.reference}, {arguments.kind.replace('_', ' ')}"
    unit = f"{SI[arguments.response]}/{SI[arguments.reference]}"
    return _drive(
        arguments,
        title,
        unit,
        lambda rig: measure(rig, excitation, arguments.response, arguments.reference),
        of=f" of {excitation.frames}",
    )


def _plan(arguments: argparse.Namespace, kind: type[P]) -> P:
    """Return the settings of a test, of the class `kind`: those in the file `arguments.plan`, or else the defaults."""
    from impact_rig_studies.excitation.files import load as load_plan  # noqa: PLC0415  # scipy

    return load_plan(arguments.plan, kind) if arguments.plan else kind()


def run_random(arguments: argparse.Namespace) -> int:
    """Shake the rig with noise of a requested power spectral density, and return the exit code.

    The code is 1 if the test ended early or has no result.
    """
    from impact_rig_studies.excitation.random import RandomPlan, control  # noqa: PLC0415  # scipy

    plan = _plan(arguments, RandomPlan)
    title = f"Random control: {plan.response.replace('_', ' ')}"
    return _drive(arguments, title, plan.response.unit, lambda rig: control(rig, plan))


def run_replicate(arguments: argparse.Namespace) -> int:
    """Make a motion of the rig follow a signal of a file or run, and return the exit code.

    The code is 1 if the test ended early or has no result.
    """
    from impact_rig_studies.excitation.history import ReplicatePlan, replicate  # noqa: PLC0415  # scipy

    plan = _plan(arguments, ReplicatePlan)
    asked = _history(arguments, plan.response.unit, plan.response.channel)
    _refuse_zeros(arguments, asked)
    title = f"Replicated: {plan.response.replace('_', ' ')} of {visible(arguments.file.name)}"
    return _drive(arguments, title, plan.response.unit, lambda rig: replicate(rig, asked, plan, _progress().print))


def run_shock(arguments: argparse.Namespace) -> int:
    """Make the base follow a half-sine pulse of acceleration, and return the exit code.

    The code is 1 if the test ended early or has no result.
    """
    from impact_rig_studies.excitation.shock import Pulse, shock  # noqa: PLC0415  # scipy

    pulse = _plan(arguments, Pulse)
    title = f"Shock: half sine of {pulse.peak:g} m/s², {1e3 * pulse.duration_s:g} ms"
    return _drive(arguments, title, "m", lambda rig: shock(rig, pulse, _progress().print))


def _history(arguments: argparse.Namespace, unit: str, name: str | None = None) -> NDArray[np.float64]:
    from impact_rig_studies.excitation.files import history  # noqa: PLC0415  # scipy

    return history(
        arguments.file, arguments.scan_rate, unit, arguments.signal, name, arguments.unit, arguments.scale,
        arguments.file_rate,
    )  # fmt: skip


def _progress() -> Console:
    return Console(stderr=True)


def _drive(arguments: argparse.Namespace, title: str, unit: str, work: Work, of: str = "") -> int:
    """Run a test that streams samples to a rig, record it, write and print its results, and return the exit code.

    Results are written and printed even if the test ends early. The code is 1 if it ended early, or if there is no
    result (`ResultSummary.missing`); else 0.

    Args:
        arguments: parsed arguments of the test.
        title: title of the results.
        unit: unit of the response.
        work: function that drives the rig, and yields its result so far repeatedly.
        of: text after each line of progress that reports a result, such as ` of 20`.

    Raises:
        ConfigError: the configuration does not drive the shaker with a current.
        ImpactRigError: the test ended before `work` yielded anything.
        KeyboardInterrupt: the user interrupted the test; results so far, if any, have been written.
    """
    from impact_rig_studies.report.excitation import document, tell  # noqa: PLC0415  # matplotlib

    stream = {
        "drive.waveform": "stream",
        "drive.stream_rate_hz": arguments.scan_rate,
        "daq.rate_hz": arguments.scan_rate,
    }
    config, gap_m = rig_of(arguments)
    config = from_flat(config, stream)
    if config.drive.kind != "current":
        raise ConfigError(
            f"{arguments.config}: drive.kind must be current, as samples are amperes here, got {config.drive.kind}"
        )
    test: str = arguments.test
    directory = run_directory(arguments.output, test)
    console, progress = Console(quiet=arguments.json), _progress()
    found, early, interrupted = None, "", None
    with contextlib.ExitStack() as writing:  # a second signal does not interrupt the work after the drive
        with open_rig(arguments, config, directory, required=stream) as rig:
            hardware = Hardware(rig, dict(arguments.abort))
            try:
                for found in work(hardware):
                    reached = tell(found, unit)
                    progress.print(reached.progress if reached.missing else f"{reached.progress}{of}")
            except (CommandError, TimeoutError) as error:
                early = str(error)
            except KeyboardInterrupt as error:
                early, interrupted = "interrupted", error
            writing.enter_context(defer_signals())
            hardware.output.stop()
        if found is None:
            raise interrupted or ImpactRigError(f"{early}; the recording so far is in {directory}")
        summary = tell(found, unit)
        figures = {
            "title": title,
            "unit": unit,
            "rate_hz": arguments.scan_rate,
            "ended_early": early,
            **summary.figures,
        }
        about = [
            ("Rig", running_namespace(arguments) or case_of(gap_m)),
            ("Through", arguments.through),
            ("Rate", f"{arguments.scan_rate} Hz"),
            ("Recording", f"{visible(directory.name)}; impact-rig verify re-simulates it"),
        ]
        files.write_json(directory / f"{test}.json", figures)
        page = directory / f"{test}.html"
        # an ending that takes too long is cut short, so the sentences come first
        files.write_text(page, document(title, about, summary, early, drawn=False))
        files.write_text(page, document(title, about, summary, early))
        for sentence in [title, *summary.sentences, *([f"ended early: {early}"] if early else [])]:
            console.print(sentence)
        tell_results(directory, figures, as_json=arguments.json)
        if interrupted:
            raise interrupted
    return 1 if early or summary.missing else 0
