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
"""Coverage of the constants that import, identify and compare determine for rigs that are known only as CSV files.

    python -m qualification.foreign_rig --rigs 400 --seed 2026 build/foreign
    python -m qualification.foreign_rig --draw build/foreign      # the picture of docs/tutorials/own_measurement.md

Everything that varies between rigs is drawn: masses (± 25 %), damping, stiffness, gaps, the coefficient of restitution
(standard deviation 0.02 about the value that is assumed as known), and the errors of all sensors within their
certificates. In addition the gain of the base sensor is wrong by 3 % (standard deviation), as its certificate states.
The rig is sampled at 1 kS/s without an accelerometer. A free decay, a stepped sine without sphere and two gaps are
written as CSV files with headings and units of their own, imported, and given to `identify` and `compare`. Where a
constant stays open, nothing settled, or `identify` asks for one more gap because there are several explanations, the
rig is measured again as its owner would: longer, and at two more gaps.

For each constant the program prints how many rigs are within twice the stated uncertainty, the rms and the largest
deviation in units of it, and how many rigs raised an alarm or were ambiguous. Results are kept, so a run can be
continued.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np

from impact_rig.blocks import joined
from impact_rig.cli.main import main as impact_rig
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, dump, from_flat
from impact_rig.rig.gaps import gap_values
from impact_rig.simtime import NS_PER_S
from qualification.results import Results

RATE_HZ, GAIN, COVERAGE = 1000, 0.03, 2.0
DETUNING = (0.82, 0.93, 0.985, 1.0, 1.015, 1.07, 1.15)
"""Frequencies of the stepped sine over that of the structure."""
SECONDS, DECAY_S, AMPLITUDE_M = 16.0, 25.0, 5.5e-3
ATTEMPTS, LONGER = 3, 1.5
"""Durations of the measurement of a rig, each longer by this factor than the one before."""
MAPPING = "channels: {laser: {column: tip}, base: {column: table}, current: {column: coil}}\n"
NAMES = ("f_n", "ζ", "m_1", "K_f", "k_f", "M", "c_f")
U_E = 0.02
"""Standard deviation of the coefficient of restitution, which `identify` assumes."""
REST_S = 40.0  # without drive between two settings: ten time constants of the structure
FAR = 4.5  # standard uncertainties by which no constant may be off without an alarm


def drawn(seed: int, number: int) -> tuple[dict[str, float], float, tuple[float, ...], np.random.Generator]:
    """Return a rig: configuration, gain of its base sensor, gaps [m], and its random generator."""
    rng = np.random.default_rng([seed, number])
    around = lambda value, share: float(value * math.exp(rng.uniform(-share, share)))  # noqa: E731  # seven times
    rig = {
        "structure.natural_frequency_hz": around(9.105, 0.15), "structure.damping_ratio": around(0.0045, 0.25),
        "structure.mass_kg": around(0.13, 0.25), "shaker.force_factor_n_a": around(5.3, 0.2),
        "shaker.suspension_stiffness_n_m": around(6300.0, 0.2), "shaker.damping_n_s_m": around(90.0, 0.2),
        "shaker.base_mass_kg": around(1.84, 0.25),
        "contact.restitution": RigConfig().contact.restitution + float(rng.normal(0.0, U_E)),
        "daq.rate_hz": RATE_HZ, "daq.block_scans": RATE_HZ, "daq.seed": int(rng.integers(2**31)),
    }  # fmt: skip
    gaps = tuple(round(float(gap), 4) for gap in sorted(rng.uniform(0.003, 0.008, 2)))
    return rig, float(rng.normal(1.0, GAIN)), gaps, rng


def plucked(config: RigConfig) -> np.ndarray:
    """Return scans of the free decay."""
    one = Rig(from_flat(config, gap_values(0.0)))
    one.pluck(5e-3)
    return joined([block.scan.rows for block in one.advance(round(DECAY_S * NS_PER_S))])


def driven(one: Rig, gap_m: float, frequency_hz: float, current_a: float, seconds: float) -> np.ndarray:
    """Return scans of a rig that comes to rest, gets a gap, and is then driven."""
    one.accept(frequency_hz, 0.0)
    one.advance(one.frontier_ns + round(REST_S * NS_PER_S))
    one.configure(gap_values(gap_m))
    one.accept(frequency_hz, current_a)
    return joined([block.scan.rows for block in one.advance(one.frontier_ns + round(seconds * NS_PER_S))])


def write_certificate(path: Path, config: RigConfig) -> None:
    """Write the sensors' certificates as a table; that of the base sensor states the wrong gain."""
    rows = Rig(config).info().rows
    names = [name for name in rows.dtype.names or () if name not in ("unit", "rate", "since_start")]
    rows["sensitivity_uncertainty"][rows["name"] == b"base"] = GAIN
    lines = [",".join(row[name].decode() if name == "name" else f"{row[name]:.17g}" for name in names) for row in rows]
    path.write_text("\n".join([",".join(names), *lines]) + "\n", encoding="utf-8")


def write_csv(path: Path, rows: np.ndarray, gain: float) -> None:
    """Write scans as a foreign program would: its own headings, millimetres, no accelerometer."""
    columns = np.stack(
        [np.arange(len(rows)) / RATE_HZ, 1e3 * rows["laser"], 1e3 * gain * rows["base"], rows["current"]], axis=1
    )
    np.savetxt(path, columns, "%.9g", delimiter=";", header="t [s];tip [mm];table [mm];coil [A]", comments="")


def run_command(*words: object) -> dict[str, object]:
    """Return the JSON output of a command of the package; empty if the command fails, which it reports itself."""
    with contextlib.redirect_stdout(io.StringIO()) as output:
        code = impact_rig([str(word) for word in words])
    return {} if code else dict(json.loads(output.getvalue()))


def measure(seed: int, number: int, place: Path, attempt: int = 0) -> None:
    """Measure a rig as its owner would, and import the measurement."""
    rig, gain, gaps, rng = drawn(seed, number)
    gaps = (*gaps, *(round(float(gap), 4) for gap in rng.uniform(0.003, 0.008, 2 * attempt)))
    seconds = SECONDS * LONGER**attempt
    f_n = rig["structure.natural_frequency_hz"]
    shutil.rmtree(place, ignore_errors=True)
    (place / "csv").mkdir(parents=True)
    (place / "mapping.yaml").write_text(MAPPING, encoding="utf-8")
    (place / "known.yaml").write_text(dump(RigConfig()), encoding="utf-8")
    stiffness = rig["structure.mass_kg"] * (2.0 * math.pi * f_n) ** 2
    current = AMPLITUDE_M * stiffness / rig["shaker.force_factor_n_a"]  # moves x_1 about that far at resonance
    config = from_flat(RigConfig(), rig)
    one = Rig(config)
    for gap in (0.0, *gaps):
        for detuning in DETUNING if gap == 0.0 else (1.0,):
            frequency = round(f_n * detuning, 3)
            rows = driven(one, gap, frequency, current, seconds)
            name = f"{f'{1e3 * gap:g}mm' if gap else 'no_sphere'}_{frequency:.3f}Hz.csv"
            write_csv(place / "csv" / name, rows, gain)
    write_csv(place / "decay.csv", plucked(config), gain)
    write_certificate(place / "certificate.csv", config)
    common = ("--mapping", place / "mapping.yaml", "--calibration", place / "certificate.csv", "--json")
    sweep = ("--campaign", "--output", place / "sweep", "--config", place / "known.yaml")
    run_command("import", *sorted((place / "csv").iterdir()), *sweep, *common)
    run_command("import", place / "decay.csv", "--output", place / "decay", *common)
    shutil.rmtree(place / "csv")
    (place / "decay.csv").unlink()


def judged(seed: int, number: int, place: Path, *, compares: bool) -> dict[str, object]:
    """Return the truth of a rig, and the results of the commands for it."""
    rig, gain, _, _ = drawn(seed, number)
    truth = dict(zip(NAMES, (
        rig["structure.natural_frequency_hz"], rig["structure.damping_ratio"], rig["structure.mass_kg"],
        rig["shaker.force_factor_n_a"], rig["shaker.suspension_stiffness_n_m"],
        rig["shaker.base_mass_kg"] + RigConfig().shaker.armature_mass_kg, rig["shaker.damping_n_s_m"],
    ), strict=True))  # fmt: skip
    run = place / "sweep" / "runs" / f"no_sphere_{rig['structure.natural_frequency_hz']:.3f}Hz"
    for attempt in range(ATTEMPTS):
        if attempt or not (place / "decay").exists():
            measure(seed, number, place, attempt)
        found = run_command("identify", place / "sweep", "--decay", place / "decay", "--json")
        compared = run_command("compare", run, "--config", place / "known.yaml", "--json") if compares else {}
        constants = {
            f"{prefix}{name}": [truth[name], value["value"], value["standard_uncertainty"]]
            for prefix, told_of in (("", found), ("compare ", compared))
            for name, value in dict(told_of.get("constants", {})).items()  # type: ignore[call-overload]  # JSON
        }
        if found.get("restitution") is not None:
            constants["e"] = [
                rig["contact.restitution"], found["restitution"], found["restitution_standard_uncertainty"],
            ]  # fmt: skip
        is_open = any(constants.get(name, [0, None])[1] is None for name in NAMES)
        if not is_open and not found.get("ambiguous"):  # otherwise identify asks for one more gap
            break
    shutil.rmtree(place)
    return {
        "number": number, "gain": gain, "consistent": found.get("consistent"), "ambiguous": found.get("ambiguous"),
        "chance": found.get("chance"), "attempts": attempt + 1, "constants": constants,
    }  # fmt: skip


def draw(place: Path) -> None:
    """Import one run of five frequencies, and draw it with a model whose structure is 0.2 % off."""
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    own = {"daq.rate_hz": RATE_HZ, "daq.block_scans": RATE_HZ, "sphere.present": False}
    config = from_flat(RigConfig(), own)
    one, parts, frequencies = Rig(config), [], []
    for frequency in (8.5, 8.9, 9.1, 9.3, 9.7):
        one.accept(frequency, 0.52)
        blocks = one.advance(one.frontier_ns + round(SECONDS * NS_PER_S))
        parts += [block.scan.rows for block in blocks]
        frequencies += [frequency] * sum(len(block.scan.rows) for block in blocks)
    write_csv(place / "no_sphere.csv", joined(parts), 1.0)
    lines = (place / "no_sphere.csv").read_text(encoding="utf-8").splitlines()
    told_hz = ["frequency [Hz]", *map(str, frequencies)]
    (place / "no_sphere.csv").write_text("\n".join(f"{line};{hz}" for line, hz in zip(lines, told_hz, strict=True)))
    (place / "mapping.yaml").write_text(MAPPING, encoding="utf-8")
    write_certificate(place / "certificate.csv", config)
    model = {"structure.natural_frequency_hz": 1.002 * config.structure.natural_frequency_hz}
    (place / "model.yaml").write_text(dump(from_flat(config, model)), encoding="utf-8")
    run_command(
        "import", place / "no_sphere.csv", "--output", place / "mine", "--mapping", place / "mapping.yaml",
        "--calibration", place / "certificate.csv", "--json",
    )  # fmt: skip
    impact_rig(["compare", str(place / "mine"), "--config", str(place / "model.yaml"), "--figures", str(place)])
    shutil.copy(place / "comparison.png", Path(__file__).parents[1] / "docs" / "images" / "comparison.png")


def main() -> int:
    """Run the rigs that are missing, print the summary and return 0."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder that keeps the results")
    parser.add_argument("--rigs", type=int, default=100, help="number of rigs (default: 100)")
    parser.add_argument("--seed", type=int, default=2026, help="seed of what is drawn (default: 2026)")
    parser.add_argument("--no-compare", action="store_true", help="leave out `impact-rig compare`")
    parser.add_argument("--draw", action="store_true", help="draw docs/images/comparison.png instead")
    arguments = parser.parse_args()
    if arguments.draw:
        draw(arguments.folder / "drawn")
        return 0
    done = Results(arguments.folder / f"found_{arguments.seed}.jsonl")
    for number in range(arguments.rigs):
        if number not in {one["number"] for one in done}:
            place = arguments.folder / f"{number:04d}"
            done.add(judged(arguments.seed, number, place, compares=not arguments.no_compare))
    return 0 if summary(done) else 1


def summary(done: list[dict[str, Any]]) -> bool:
    """Print how the stated uncertainties cover the truth; return whether none is far off without an alarm."""
    alarms = [not each["consistent"] for each in done]
    ambiguous = [bool(each["ambiguous"]) and not alarm for each, alarm in zip(done, alarms, strict=True)]
    again = sum(each["attempts"] > 1 for each in done)
    print(f"{len(done)} rigs, {again} measured again; {sum(alarms)} alarms, {sum(ambiguous)} ambiguous")  # noqa: T201  # the result
    sound = True
    for name in (*NAMES, "e", "compare f_n", "compare ζ"):  # one frequency without a sphere determines no more
        rows = [each["constants"].get(name, [0, None, None]) for each in done]
        found = [(row, alarm) for row, alarm in zip(rows, alarms, strict=True) if row[1] is not None]
        if not found:
            continue
        z = np.array([(value - truth) / u for (truth, value, u), _ in found])
        inside = np.count_nonzero(np.abs(z) <= COVERAGE) / len(done)
        quiet = np.abs(z[[not alarm for _, alarm in found]]).max(initial=0.0)
        sound = sound and bool(quiet <= FAR)
        print(  # noqa: T201  # as above
            f"{name:14s} {100 * inside:.1f} % within ± {COVERAGE:g} u, rms z {math.sqrt(float(np.mean(z**2))):.2f}, "
            f"largest |z| {np.abs(z).max():.1f}, {quiet:.1f} without an alarm, {len(done) - len(z)} not found"
        )
    return sound


if __name__ == "__main__":
    sys.exit(main())
