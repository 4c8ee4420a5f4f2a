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
"""Random legal configurations that must not hang, abort or lose energy: `python -m qualification.legal_configurations`.

Values are drawn from their complete allowed ranges: in half of the configurations all values, in the others a few, with
the rest at their defaults. Numbers are uniform in their logarithm, and sometimes an end of the range. The rig runs with
its instruments, ten ticks at a time. In a third of the steps it gets a new amplitude command, up to the shaker's limit.
A configuration that the rig rejects at its start counts as refused.

A run that takes more than `--limit` seconds of CPU time counts as hanging. The unaccounted energy may be at most 1e-8
of the largest of: work, losses, stored energy, and the sphere's energy at a thousandth of the least approach speed. A
slower contact is not resolved relatively.

Each failure is printed as a configuration file with its number, which `--only` repeats. The exit status is 1 if there
is a failure.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import resource
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection

import attrs
import numpy as np
from rich.console import Console

from impact_rig.config.fields import LEAST, MOST, FieldInfo
from impact_rig.errors import CommandError, ConfigError, SimulationError
from impact_rig.instruments.section import CHANNELS as SCANNED
from impact_rig.instruments.sensor import ADC_RANGES_V
from impact_rig.physics import Simulation
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, dump, fields, from_flat
from impact_rig.rig.interlock import amplitude_limit
from impact_rig.simtime import COMMAND_GRID_NS, COMMAND_GRID_S, NS_PER_S

UNACCOUNTED = 1e-8
STEP_NS = 10 * COMMAND_GRID_NS
FEW, AT_AN_END = 0.1, 0.02
"""Probabilities that a value differs if only a few do, and that a number is an end of its range."""
NOT_DRAWN = ("time.", "step.", "pluck.", "output.", "instruments.faults.", "daq.block_scans")
"""Fields that affect neither mechanics nor instruments; for the length of a block see
test/impact_rig/rig/test_time_base.py.
"""
FASTEST_NOISE_HZ = 44.0
"""Highest frequency that the grid of ticks supports at every clock error."""
OK, REFUSED, ABORTED, HANGS, NOT_FINITE, ENERGY = "ok", "refused", "aborted", "hangs", "not finite", "energy"
FAILURES = (ABORTED, HANGS, NOT_FINITE, ENERGY)


@attrs.frozen
class Result:
    """Result of a run: one of the words above, unaccounted part of the energy, number of impacts, and a message."""

    ended: str
    unaccounted: float = 0.0
    impacts: int = 0
    said: str = ""


def unaccounted(simulation: Simulation) -> float:
    """Return the unaccounted part of the energy."""
    energy, p = simulation.energy(), simulation.parameters
    lost = energy.columns + energy.shaker + energy.contact + energy.friction
    unresolved = 0.5 * float(p["m"]) * (1e-3 * float(p["speed_floor"])) ** 2
    return abs(energy.imbalance) / max(abs(energy.work), abs(lost), abs(energy.stored), unresolved)


def number(about: FieldInfo, default: float, random: np.random.Generator) -> float:
    """Return a number from a field's range: uniform in the logarithm, or in the range if that contains both signs."""
    low = LEAST if about.low is None else float(about.low)
    high = MOST if about.high is None else float(about.high)
    at_end = random.random() < AT_AN_END
    if at_end and low == 0.0 and not about.low_open:
        return 0.0
    if low < 0.0:
        return random.uniform(low, high)
    low, high = max(low, LEAST), min(high, MOST)
    if at_end:
        low_end = random.random() < 0.5
        if not (about.low_open if low_end else about.high_open):
            return low if low_end else high
    if about.low == 0.0 and not about.low_open and default > 0.0:
        low = max(low, 1e-6 * min(default, high))  # in a range from 0 on, all lower decades are equivalent
    return math.exp(random.uniform(math.log(low), math.log(high) - 1e-12))


def value(name: str, about: FieldInfo, default: object, random: np.random.Generator) -> object:
    """Return an allowed value of a field."""
    if name.endswith("adc_range_v"):
        return float(random.choice(ADC_RANGES_V))
    if about.choices:
        return str(random.choice(about.choices))
    if isinstance(default, bool):
        return bool(random.random() < 0.5)
    if isinstance(default, int):
        assert about.low is not None
        assert about.high is not None
        return round(math.exp(random.uniform(math.log(max(about.low, 1)), math.log(about.high))))
    assert isinstance(default, float)
    return number(about, default, random)


def drawn(seed: int, index: int) -> tuple[dict[str, object], float]:
    """Return the non-default values of configuration `index`, and its amplitude relative to the limit."""
    random = np.random.default_rng((seed, index))
    every = random.random() < 0.5
    values = {
        name: value(name, about, default, random)
        for name, about, default in fields()
        if not name.startswith(NOT_DRAWN) and not isinstance(default, tuple)
        if random.random() < (1.0 if every else FEW)
    }
    return values, 10.0 ** random.uniform(-8.0, 0.0)


def legal(values: dict[str, object]) -> RigConfig:
    """Return a configuration with these values, with contradictory ones (limits, bands, rates) corrected.

    Raises:
        ConfigError: the values are jointly invalid.
    """
    flat = {name: default for name, _, default in fields()} | values

    def of(name: str) -> float:
        return float(str(flat[name]))

    low, high = sorted(of(f"shaker.frequency_{end}_hz") for end in ("min", "max"))
    flat |= {"shaker.frequency_min_hz": low, "shaker.frequency_max_hz": high}
    flat["drive.frequency_hz"] = min(max(of("drive.frequency_hz"), low), high)
    low, high = sorted(min(of(f"drive.random_{end}_hz"), FASTEST_NOISE_HZ) for end in ("low", "high"))
    flat |= {"drive.random_low_hz": min(low, 0.9 * high), "drive.random_high_hz": high, "drive.amplitude": 0.0}
    rates = len(SCANNED) * of("daq.rate_hz")
    flat["instruments.adc.aggregate_limit_hz"] = max(of("instruments.adc.aggregate_limit_hz"), rates)
    nearest = 0.99 * of("instruments.laser.distance_m")
    flat["instruments.laser.half_range_m"] = min(of("instruments.laser.half_range_m"), nearest)
    if flat["drive.kind"] == "prescribed":  # a base cannot jump
        flat["drive.stream_hold"] = "first_order"
    return from_flat(RigConfig(), flat)


def feed(rig: Rig, amplitude: float) -> None:
    """Send a rig the next samples of its stream, a sine of the drive's frequency: two ticks, or one sample, ahead."""
    drive, now_s = rig.config.drive, rig.frontier_ns / NS_PER_S
    ahead_s = min(drive.stream_buffer_s, max(2.0 * COMMAND_GRID_S, 1.1 / drive.stream_rate_hz))
    numbers = np.arange(math.ceil(now_s * drive.stream_rate_hz), int((now_s + ahead_s) * drive.stream_rate_hz))
    if len(numbers):
        angle = 2.0 * math.pi * drive.frequency_hz / drive.stream_rate_hz * numbers
        rig.feed(int(numbers[0]), amplitude * np.sin(angle))


def run(config: RigConfig, loudness: float, seconds: float) -> Result:
    """Run a rig and evaluate it."""
    limit = amplitude_limit(config.drive, config.shaker)[2]
    amplitude = loudness * limit
    impacts = 0
    try:
        rig = Rig(from_flat(config, {"drive.amplitude": amplitude}))
    except ConfigError as error:
        return Result(REFUSED, said=str(error))
    end_ns, finite, commanded = round(seconds * NS_PER_S), True, False
    try:
        while rig.frontier_ns < end_ns:
            step_ns = STEP_NS
            if rig.latched is None and config.drive.waveform == "stream":
                step_ns = COMMAND_GRID_NS  # a stream buffers as few as two ticks
                feed(rig, limit if rig.frontier_ns >= end_ns / 3 else amplitude)
            elif not commanded and rig.frontier_ns >= end_ns / 3 and rig.latched is None:
                rig.accept(amplitude=min(2.0 * amplitude, limit))
                commanded = True
            for block in rig.advance(rig.frontier_ns + step_ns):
                impacts += 0 if block.impacts is None else len(block.impacts.rows)
                finite &= all(np.isfinite(block.scan.rows[name]).all() for name in block.scan.rows.dtype.names or ())
    except (SimulationError, CommandError, ArithmeticError, ValueError, AssertionError) as error:
        return Result(ABORTED, unaccounted(rig.simulation), impacts, f"{type(error).__name__}: {error}")
    missing = unaccounted(rig.simulation)
    ended = NOT_FINITE if not finite or not math.isfinite(missing) else ENERGY if missing > UNACCOUNTED else OK
    return Result(ended, missing, impacts, str(rig.simulation.energy()) if ended == ENERGY else "")


def work(connection: Connection, seed: int, seconds: float, limit_s: float) -> None:
    """Run the configurations with the received numbers; a run beyond the limit ends the process."""
    while True:
        values, loudness = drawn(seed, connection.recv())
        _, hard = resource.getrlimit(resource.RLIMIT_CPU)
        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(time.process_time() + limit_s), hard))
        try:
            config = legal(values)
        except ConfigError as error:
            connection.send(Result(REFUSED, said=str(error)))
            continue
        connection.send(run(config, loudness, seconds))


def results(indices: Sequence[int], seed: int, seconds: float, limit_s: float) -> Iterator[tuple[int, Result]]:
    """Yield the result of each configuration; each run has a process, which a hanging run takes with it."""
    context = multiprocessing.get_context("fork")
    worker = None
    for index in indices:
        if worker is None:
            here, there = context.Pipe()
            worker = context.Process(target=work, args=(there, seed, seconds, limit_s), daemon=True)
            worker.start()
            there.close()
        here.send(index)
        try:
            yield index, here.recv()
        except EOFError:
            worker.join()
            worker = None
            yield index, Result(HANGS, said=f"more than {limit_s:g} s of the processor for {seconds:g} s")
    if worker is not None:
        worker.terminate()
        worker.join()


def report(index: int, seed: int, result: Result) -> str:
    """Return a failed configuration as a file, with the result as a comment above it."""
    values, loudness = drawn(seed, index)
    config = legal(values)
    config = from_flat(config, {"drive.amplitude": loudness * amplitude_limit(config.drive, config.shaker)[2]})
    head = f"# configuration {index} of seed {seed}: {result.ended}, {result.unaccounted:.2g} of the energy unaccounted"
    return f"{head}, {result.impacts} impacts\n# {result.said}\n{dump(config)}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=4000, help="number of configurations (default: %(default)s)")
    parser.add_argument("--first", type=int, default=0, help="number of the first configuration (default: 0)")
    parser.add_argument("--only", type=int, nargs="*", help="numbers of the only configurations to run")
    parser.add_argument("--seconds", type=float, default=5.0, help="seconds of rig time (default: 5)")
    parser.add_argument("--limit", type=float, default=60.0, help="largest CPU time of a run [s] (default: 60)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the configurations (default: 1)")
    options = parser.parse_args(arguments)
    indices = options.only or range(options.first, options.first + options.count)
    say = Console(soft_wrap=True, markup=False, highlight=False).print
    counts: Counter[str] = Counter()
    worst = 0.0
    for done, (index, result) in enumerate(results(indices, options.seed, options.seconds, options.limit), start=1):
        counts[result.ended] += 1
        if result.ended == OK:
            worst = max(worst, result.unaccounted)
        if result.ended in FAILURES:
            say(report(index, options.seed, result))
        if sys.stderr.isatty() or done % 100 == 0:
            Console(stderr=True).print(f"{done} of {len(indices)}: {dict(counts)}")
    ended = ", ".join(f"{counts[word]} {word}" for word in (OK, REFUSED, *FAILURES))
    say(f"{len(indices)} configurations: {ended}; at most {worst:.2g} of the energy unaccounted in a run that is ok")
    return 1 if any(counts[word] for word in FAILURES) else 0


if __name__ == "__main__":
    sys.exit(main())
