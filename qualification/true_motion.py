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
"""Results of replication, shock and frequency response against the truth: `python -m qualification.true_motion FOLDER`.

A rig in this process publishes its true motion in addition to its readings. Each case is driven, and the results of the
command are compared with the truth of the same trial:

    replicate  base and superior base, with and without sphere: the true error is at most the sum of the stated error
               and the stated floor, and the stated error at most 0.5 %
    shock      every stated figure is within its floor of the true one
    frf        accelerometer over current, with all kinds of excitation: 92 % of the coherent lines of all seeds within
               2u (the lines of one rig share its calibration errors, so their number varies much from seed to seed)

Results are kept in FOLDER, so a run can be resumed. The exit code is 1 if a case fails.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy import signal

from impact_rig import topics
from impact_rig.analysis.calibration import Real
from impact_rig.driver import Hardware, LocalRig
from impact_rig.physics.linear import constants, input_vectors, state_matrix
from impact_rig_studies.excitation.history import Replicated, ReplicatePlan, replicate
from impact_rig_studies.excitation.response import Response, measure
from impact_rig_studies.excitation.shock import Pulse, Shocked, differentiated, shock, shock_response_spectrum
from impact_rig_studies.excitation.signals import KINDS, Excitation
from qualification.results import Results

RATE_HZ, SHOCK_HZ = 2_000, 10_000
MOST = 0.005  # stated error of a replication
SHARE = 0.92  # of the lines of a response within 2u
TRUE = {Response.BASE: "x_b", Response.SUPERIOR: "x_1"}


class _WatchedRig(LocalRig):
    def __init__(self, settings: dict[str, object]) -> None:
        super().__init__(settings, also=[topics.TRUTH_SCAN.name])
        self.truth: list[NDArray[np.void]] = []

    def clear(self) -> None:
        self.truth.append(self.rows(topics.TRUTH_SCAN.name))
        super().clear()


class TrueHardware(Hardware):
    """A rig in this process that remembers its true motion.

    Attributes:
        truth: rows of `truth/scan` of the latest trial, one row per sample.
    """

    truth: NDArray[np.void]

    def __init__(self, rate_hz: int, **values: object) -> None:
        settings = {
            "drive.waveform": "stream", "drive.stream_rate_hz": rate_hz, "daq.rate_hz": rate_hz,
            "daq.block_scans": 1_000, "output.truth_scan": True,
        }  # fmt: skip
        self.watched = _WatchedRig(settings | {name.replace("__", "."): value for name, value in values.items()})
        super().__init__(self.watched)
        self._ends = 0  # scan at which the latest trial ended

    def respond(self, samples: Real, rest: int = 0) -> NDArray[np.void]:  # type: ignore[override]  # of arrays only
        """Play samples, as `Hardware.respond` does."""
        rows = super().respond(samples, rest)
        end = self.acquisition.next_scan
        assert end is not None
        newer = np.concatenate(self.watched.truth)  # than the trial before
        before, self._ends = self._ends, end
        self.truth = newer[end - len(rows) - before : end - before]
        self.watched.truth = [newer[end - before :]]
        return rows


def history(band_hz: tuple[float, float], rms_m: float, seed: int, seconds: int = 4) -> Real:
    """Return some seconds of noise in a band, without content that a plan for this band could not reach."""
    sections = signal.butter(8, band_hz, "bandpass", fs=RATE_HZ, output="sos")
    noise = np.random.default_rng(seed).standard_normal((2 + seconds) * RATE_HZ)
    asked = signal.sosfilt(sections, noise)[2 * RATE_HZ :]
    asked *= signal.windows.hann(len(asked))
    return np.asarray(asked * (rms_m / asked.std()))


def replicated(
    response: Response,
    *,
    sphere: bool,
    seed: int,
    seconds: int = 4,
    on_step: Callable[[str], object] = lambda _: None,
    **settings: float,
) -> tuple[Replicated, float, NDArray[np.void]]:
    """Replicate a history of some seconds; `settings` are fields of the plan that differ from their defaults.

    Returns:
        The stated result, the true error, and the true motion of the last trial.
    """
    superior = response is Response.SUPERIOR
    asked = history((6.0, 14.0) if superior else (6.0, 40.0), 1.5e-3 if superior else 3e-4, seed, seconds)
    plan = attrs.evolve(
        ReplicatePlan(response=response, identify_rms=0.15 if superior else 2.0, high_hz=25.0 if superior else 150.0),
        **settings,
    )
    hardware, best, errors = TrueHardware(RATE_HZ, sphere__present=sphere, daq__seed=seed), None, math.nan
    for best in replicate(hardware, asked, plan, on_step):
        if best.repeated is None and best.errors[-1] == min(best.errors):
            true = hardware.truth[TRUE[response]].astype(float)
            true -= true[best.quiet].mean()
            errors = best.relative(true[best.lead : best.lead + len(asked)] - asked)
    assert best is not None
    return best, errors, hardware.truth


def shocked(seed: int) -> tuple[Shocked, dict[str, float]]:
    """Make a shock; return the stated figures and the true ones."""
    hardware, pulse = TrueHardware(SHOCK_HZ, sphere__present=False, daq__seed=seed), Pulse()
    best, true = None, {}
    corner_hz = 3.0 / pulse.duration_s
    wanted, smooth = differentiated(pulse.displacement(SHOCK_HZ), SHOCK_HZ, corner_hz)
    on = slice(round(pulse.compensation_s * SHOCK_HZ), round((pulse.compensation_s + pulse.duration_s) * SHOCK_HZ))
    for best in shock(hardware, pulse):
        errors = best.followed.errors
        if best.followed.repeated is None and errors[-1] == min(errors):
            moved = hardware.truth["x_b"].astype(float)
            moved -= moved[best.followed.quiet].mean()
            moved = moved[best.followed.lead : best.followed.lead + len(best.asked)]
            velocity, reached = differentiated(moved, SHOCK_HZ, corner_hz)
            srs = shock_response_spectrum(reached, SHOCK_HZ, best.frequency_hz)
            true = {
                "peak_error": float(reached.max() / smooth.max() - 1.0),
                "velocity_error": float(np.ptp(velocity[on]) / np.ptp(wanted[on]) - 1.0),
                "left_m": float(moved[-1]),
                "srs_worst_db": float(np.abs(20.0 * np.log10(srs / best.srs_asked)).max()),
            }
    assert best is not None
    return best, true


def accelerometer(kind: str, seed: int) -> tuple[float, int]:
    """Measure accelerometer over current without sphere; return the share of lines within 2u, and their number."""
    hardware = TrueHardware(RATE_HZ, sphere__present=False, daq__seed=seed)
    *_, found = measure(hardware, Excitation(kind=kind, seed=seed), "accelerometer")
    lines = found.excited[found.coherence[found.excited] > 0.9]
    f = found.frequency_hz[lines]
    c = constants(hardware.watched.config)
    matrix, b = state_matrix(c, "current", c.m_1), input_vectors(c, "current", c.m_1)[0]
    moved = np.array([np.linalg.solve(2j * np.pi * one * np.eye(4) - matrix, b)[0] for one in f])
    off = found.h1[lines] / (-((2.0 * np.pi * f) ** 2) * moved) - 1.0
    u = 2.0 * found.u_relative[lines]
    return float(np.mean((np.abs(np.abs(1.0 + off) - 1.0) < u) & (np.abs(np.angle(1.0 + off)) < u))), len(lines)


def judged(case: str, seed: int) -> dict[str, object]:
    """Return the stated results of a case, the truth, and whether they agree."""
    what, *how = case.split()
    if what == "replicate":
        stated, error, _ = replicated(Response(how[0]), sphere=how[1] == "sphere", seed=seed)
        own = min(stated.errors)
        kept = error <= own + stated.floor and own <= MOST
        return {"kept": kept, "stated": own, "floor": stated.floor, "true": error}
    if what == "shock":
        pulse, true = shocked(seed)
        stated_of = {name: getattr(pulse, name) for name in true}
        kept = all(abs(stated_of[name] - true[name]) <= pulse.floors[name] for name in true)
        return {"kept": kept, "stated": stated_of, "floor": dict(pulse.floors), "true": true}
    share, lines = accelerometer(how[0], seed)
    return {"kept": None, "share": share, "lines": lines}


CASES = (
    *(f"replicate {one.value} {sphere}" for one in TRUE for sphere in ("bare", "sphere")), "shock",
    *(f"frf {kind}" for kind in KINDS),
)  # fmt: skip


def main() -> int:
    """Run the cases that are missing; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder that keeps the results")
    parser.add_argument("--seeds", type=int, default=5, help="number of seeds of the instruments (default: 5)")
    arguments = parser.parse_args()
    done = Results(arguments.folder / "true_motion.jsonl")
    for seed in range(1, arguments.seeds + 1):
        for case in CASES:
            if not any(one["case"] == case and one["seed"] == seed for one in done):
                done.add({"case": case, "seed": seed, **judged(case, seed)})
                print(done[-1], flush=True)  # noqa: T201  # the result
    kept = [one["kept"] for one in done if one["kept"] is not None]
    for case in (case for case in CASES if case.startswith("frf")):
        rows = [(one["share"], one["lines"]) for one in done if one["case"] == case]
        shares, lines = np.array(rows).T
        share = float(shares @ lines / lines.sum())
        print(f"{case}: {100.0 * share:.1f} % of {lines.sum():.0f} lines within 2u")  # noqa: T201  # as above
        kept.append(share >= SHARE)
    print(f"{sum(kept)} of {len(kept)} kept")  # noqa: T201  # as above
    return 0 if all(kept) else 1


if __name__ == "__main__":
    sys.exit(main())
