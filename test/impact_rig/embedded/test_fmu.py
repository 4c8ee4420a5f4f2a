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
"""A rig without Python gives the bits of the rig in Python, as a co-simulation unit driven by FMPy."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import impact_rig
from impact_rig import kernels
from impact_rig.embedded.fmu import MOTION, NAMES, READINGS, VERSIONS, write_fmu
from impact_rig.embedded.snapshot import snapshot
from impact_rig.errors import ConfigError, ImpactRigError
from impact_rig.physics.sampling import QUANTITIES, Trajectory
from impact_rig.physics.simulation import Motion
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, dump, from_flat

fmpy = pytest.importorskip("fmpy", reason="pip install fmpy")
pytestmark = pytest.mark.skipif(kernels.MODE != "library", reason="kernels run otherwise here")
MOTIONS = [MOTION + i for i in range(len(QUANTITIES))]
PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "fmu.md"
TICK_NS = 10_000_000
CHANGES: list[dict[str, Any]] = [
    {},
    {"barriers.gap_m": 0.002, "contact.law": "flores"},
    {"contact.law": "restitution", "daq.rate_hz": 50_000},
    {"sphere.guide_friction": 0.1, "daq.clock_error_ppm": 40.0},
]


class Native:
    """Rig in Python, read like a unit: the motion at the end of a step, and the newest readings."""

    def __init__(self, config: RigConfig) -> None:
        self.rig = Rig(config)
        self.motion: Any = None
        self.rows = np.zeros(0, self.rig._chain._row_type)
        self.readings: list[float] = []
        self.impacts = 0
        advance = self.rig._simulation.advance

        def kept(segments: Any) -> Any:
            self.motion = advance(segments)
            self.impacts += len(self.motion.impacts)
            return self.motion

        self.rig._simulation.advance = kept  # type: ignore[method-assign]

    def step(self, ticks: int) -> None:
        self.rig._simulate(ticks)
        chain = self.rig._chain
        self.rows = np.concatenate([self.rows, chain.read(chain.ready)])
        last = self.rows[-1:]
        self.readings = [float(last[name][0]) for name in chain._names]

    def values(self) -> list[float]:
        tick_s = self.rig._generator._tick_s
        last = np.array([self.motion.last_tick])
        return [*self.motion.quantities(QUANTITIES, last, np.array([tick_s]))[:, 0].tolist(), *self.readings]


class Unit:
    """Instance of a co-simulation unit of either version."""

    def __init__(self, path: Path, folder: Path) -> None:
        description = fmpy.read_model_description(str(path))
        self.two = description.fmiVersion == "2.0"
        self.channels = sum(one.name.startswith("reading_") for one in description.modelVariables)
        self.fmu = fmpy.instantiate_fmu(fmpy.extract(str(path), str(folder)), description, "CoSimulation")
        if self.two:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.ready = False

    def set(self, reference: int, value: float) -> None:
        (self.fmu.setReal if self.two else self.fmu.setFloat64)([reference], [value])

    def get(self, references: list[int]) -> list[float]:
        return list((self.fmu.getReal if self.two else self.fmu.getFloat64)(references))

    def step(self, now: float, length: float) -> None:
        if not self.ready:
            self.fmu.exitInitializationMode()
            self.ready = True
        self.fmu.doStep(now, length)

    def values(self) -> list[float]:
        return self.get([*MOTIONS, *(READINGS + i for i in range(self.channels))])


Written = Callable[..., Path]
"""Function that returns the file of a unit, for a configuration and a version."""


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    """Return a function that compiles each unit once."""
    found: dict[tuple[str, str], Path] = {}

    def file(config: RigConfig, version: str = VERSIONS[0]) -> Path:
        key = dump(config), version
        if key not in found:
            unit = tmp_path_factory.mktemp("fmu") / "rig.fmu"
            write_fmu(config, unit, version)  # starts a compiler; `make check` skips the test there
            found[key] = unit
        return found[key]

    return file


@pytest.fixture(scope="module", params=VERSIONS)
def path(request: pytest.FixtureRequest, written: Written) -> Path:
    return written(RigConfig(), request.param)


@pytest.fixture
def unit(path: Path, tmp_path: Path) -> Iterator[Unit]:
    found = Unit(path, tmp_path)
    yield found
    found.fmu.freeInstance()


def test_the_unit_is_valid(path: Path) -> None:
    validate = pytest.importorskip("fmpy.validation").validate_fmu
    assert validate(str(path)) == []


@pytest.mark.parametrize("version", VERSIONS)
def test_a_unit_of_samples_is_valid(version: str, tmp_path: Path, written: Written) -> None:
    validate = pytest.importorskip("fmpy.validation").validate_fmu
    path = written(of_samples(1000, "first_order"), version)
    assert validate(str(path)) == []


def test_outputs_have_the_documented_names(path: Path) -> None:
    names = [one.name for one in fmpy.read_model_description(str(path)).modelVariables]
    assert [NAMES.get(one, one) for one in QUANTITIES] == names[-len(QUANTITIES) - 5 : -5]
    assert names[-4:] == [f"reading_{one}" for one in ("accelerometer", "laser", "base", "current")]


@pytest.mark.parametrize("ticks", [1, 5, 50])
def test_a_unit_yields_the_bits_of_the_rig(unit: Unit, ticks: int) -> None:
    """The current changes during the run."""
    native = Native(RigConfig())
    unit.set(1, 9.1)
    for current, steps in ((0.52, 100 // ticks), (0.3, 50 // ticks)):
        unit.set(2, current)
        native.rig.accept(9.1 if current == 0.52 else None, current)
        for _ in range(steps):
            unit.step(native.rig._ticks * 0.01, ticks * 0.01)
            native.step(ticks)
            assert unit.values() == native.values()
    assert unit.get([30]) == [native.impacts]
    assert native.impacts > 20


@pytest.mark.parametrize("changes", CHANGES, ids=str)
def test_a_unit_of_another_rig_yields_the_bits_of_that_rig(
    changes: dict[str, Any], tmp_path: Path, written: Written
) -> None:
    config = from_flat(RigConfig(), changes)
    path = written(config)
    unit, native = Unit(path, tmp_path / "unpacked"), Native(config)
    unit.set(1, 8.9)
    unit.set(2, 0.5)
    native.rig.accept(8.9, 0.5)
    for _ in range(20):
        unit.step(native.rig._ticks * 0.01, 0.05)
        native.step(5)
        assert unit.values() == native.values()
    unit.fmu.freeInstance()


def test_a_unit_with_another_gap_equals_a_reconfigured_rig(unit: Unit) -> None:
    native = Native(RigConfig())
    unit.set(2, 0.5)
    native.rig.accept(None, 0.5)
    for gap in (0.006, 0.003):
        unit.set(3, gap)
        native.rig._simulation.configure(from_flat(RigConfig(), {"barriers.gap_m": gap}))
        for _ in range(20):
            unit.step(native.rig._ticks * 0.01, 0.02)
            native.step(2)
            assert unit.values() == native.values()


def test_a_restored_state_leads_to_the_same_future(unit: Unit) -> None:
    unit.set(1, 9.1)
    unit.set(2, 0.52)
    for i in range(20):
        unit.step(0.05 * i, 0.05)
    get, put, pack, unpack, free = (
        getattr(unit.fmu, name, None) or getattr(unit.fmu, name.replace("FMUState", "FMUstate").replace("deS", "deS"))
        for name in ("getFMUState", "setFMUState", "serializeFMUState", "deserializeFMUState", "freeFMUState")
    )
    state = get()
    data = pack(state)

    def future() -> list[list[float]]:
        found = []
        for i in range(20, 40):
            unit.step(0.05 * i, 0.05)
            found.append(unit.values())
        return found

    first = future()
    put(state)
    assert future() == first
    free(state)
    put(unpack(data))
    assert future() == first


def of_samples(rate_hz: int, hold: str, **changes: Any) -> RigConfig:
    drive = {"drive.waveform": "stream", "drive.stream_rate_hz": rate_hz, "drive.stream_hold": hold}
    return from_flat(RigConfig(), {**drive, **changes})


def drive_of(rate_hz: int, count: int) -> list[float]:
    """Return samples of two sines that are strong enough for impacts."""
    t = np.arange(count) / rate_hz
    found: list[float] = (0.5 * np.sin(2 * np.pi * 9.1 * t) + 0.1 * np.sin(2 * np.pi * 31.7 * t + 1.0)).tolist()
    return found


def begin(unit: Unit, first: float) -> None:
    """Set the sample at time 0, from which the first straight line begins."""
    unit.set(2, first)
    unit.fmu.exitInitializationMode()
    unit.ready = True


def motions_of(native: Native, tick: int) -> dict[int, list[float]]:
    """Return the motion of the last tick at the end of each segment of the drive, by time [ns]."""
    model, found, work = native.motion.sampled
    tick_s = native.rig._generator._tick_s
    at = {}
    for k, end in enumerate([*found.segments["begin"][1:].tolist(), tick_s]):
        rows, history = found.first_state[: k + 2], found.history[: found.first_state[k + 1] + 1]
        trajectory = Trajectory(found.segments[: k + 1], tick, np.array([0, k + 1]), history, rows)
        part = Motion(model, trajectory, native.motion.impacts, work)
        values = part.quantities(QUANTITIES, np.array([tick]), np.array([end]))[:, 0]
        at[tick * TICK_NS + round(end / tick_s * TICK_NS)] = values.tolist()
    return at


@pytest.mark.heavy
@pytest.mark.parametrize("hold", ["zero_order", "first_order"])
@pytest.mark.parametrize(
    ("rate_hz", "seconds", "version"), [(1000, 1.0, "2.0"), (10_000, 0.5, "3.0"), (777, 1.0, "3.0")]
)
def test_a_unit_of_samples_yields_the_bits_of_a_rig_with_the_same_samples(
    rate_hz: int, seconds: float, version: str, hold: str, tmp_path: Path, written: Written
) -> None:
    """Compare motion and impacts at the end of each step, and the newest readings that are complete by then."""
    config, steps, ahead = of_samples(rate_hz, hold), round(rate_hz * seconds), hold == "first_order"
    values = drive_of(rate_hz, steps + rate_hz // 50)
    native = Native(config)
    native.rig.feed(0, values)
    times = [native.rig.stream.time_ns(k) for k in range(steps + 1)]
    motions: dict[int, list[float]] = {}
    for tick in range(-(-times[-1] // TICK_NS)):
        native.step(1)
        motions |= motions_of(native, tick)
    chain = native.rig._chain
    rows = native.rows
    last_skew, period = chain._clock.skews[-1], chain._clock.lengths.period
    path = written(config, version)
    unit = Unit(path, tmp_path / "unpacked")
    begin(unit, values[0])
    for k in range(steps):
        unit.set(2, values[k + ahead])
        unit.step(times[k] / 1e9, (times[k + 1] - times[k]) / 1e9)
        scan = (times[k + 1] * config.daq.rate_hz * len(chain._names) - last_skew) // period
        assert unit.values() == [*motions[times[k + 1]], *(float(rows[name][scan]) for name in chain._names)]
    assert unit.get([30]) == [native.impacts]  # the last tick of 777 Hz has none
    assert native.impacts > 3
    unit.fmu.freeInstance()


@pytest.mark.parametrize("version", VERSIONS)
def test_a_state_restored_between_ticks_leads_to_the_same_future(
    version: str, tmp_path: Path, written: Written
) -> None:
    """Steps have uneven lengths; some states lie within a contact, whose readings are not complete yet."""
    config = of_samples(10_000, "first_order", **{"barriers.gap_m": 0.002})
    path = written(config, version)
    unit, other = (Unit(path, tmp_path / f"unpacked_{i}") for i in range(2))
    begin(unit, 0.0)
    begin(other, 0.3)  # forgotten
    get, pack = ("getFMUstate", "serializeFMUstate") if unit.two else ("getFMUState", "serializeFMUState")
    put, unpack = ("setFMUstate", "deSerializeFMUstate") if unit.two else ("setFMUState", "deserializeFMUState")
    lengths = [13e-6, 100e-6, 7e-6, 1.7e-3, 250e-6] * 60
    now, first = 0.0, []
    sizes: set[int] = set()
    kept: dict[int, tuple[float, bytes]] = {}
    for i, length in enumerate(lengths):
        if i % 7 == 0:
            state = getattr(unit.fmu, get)()
            data = getattr(unit.fmu, pack)(state)
            kept[i], sizes = (now, data), sizes | {len(data)}
        unit.set(2, 0.6 * np.sin(57.0 * now))
        unit.step(now, length)
        now += length
        first.append(unit.values())
    assert len(sizes) > 2, "no state was in the middle of a contact"
    for at, (now, data) in kept.items():
        getattr(other.fmu, put)(getattr(other.fmu, unpack)(data))
        after = now
        for i in range(at, min(at + 12, len(lengths))):
            other.set(2, 0.6 * np.sin(57.0 * after))
            other.step(after, lengths[i])
            after += lengths[i]
            assert other.values() == first[i]
    unit.fmu.freeInstance()
    other.fmu.freeInstance()


def test_a_new_gap_takes_effect_at_the_next_tick(tmp_path: Path, written: Written) -> None:
    config = of_samples(1000, "zero_order")
    path = written(config)
    unit, native = Unit(path, tmp_path / "unpacked"), Native(config)
    values = drive_of(1000, 400)
    native.rig.feed(0, values)
    begin(unit, values[0])
    for k, value in enumerate(values[:300]):
        if k == 145:
            unit.set(3, 0.003)
        unit.set(2, value)
        unit.step(k / 1000, 0.001)
        if k % 10 == 9:
            if k == 159:
                native.rig._simulation.configure(from_flat(config, {"barriers.gap_m": 0.003}))
            native.step(1)
            assert unit.values()[:12] == native.values()[:12]
    unit.fmu.freeInstance()


@pytest.mark.parametrize(("value", "length"), [(1e3, 0.001), (float("nan"), 0.001), (0.1, 0.0)])
def test_samples_out_of_range_and_steps_of_zero_length_are_rejected(
    value: float, length: float, tmp_path: Path, written: Written
) -> None:
    path = written(of_samples(1000, "zero_order"))
    unit = Unit(path, tmp_path / "unpacked")
    names = [one.name for one in fmpy.read_model_description(str(path)).modelVariables]
    assert "frequency" not in names
    unit.set(2, value)
    with pytest.raises(Exception, match=r"fmi3|[23]"):
        unit.step(0.0, length)
    unit.fmu.freeInstance()


def test_a_step_off_the_grid_is_discarded(unit: Unit) -> None:
    unit.step(0.0, 0.01)
    before = unit.values()
    for length in (0.004, 0.015, 0.0):
        with pytest.raises(Exception, match=r"discard|2"):
            unit.step(0.01, length)
    assert unit.values() == before
    unit.step(0.01, 0.01)


@pytest.mark.parametrize(
    ("reference", "value"), [(1, 1e6), (1, -1.0), (2, 1e3), (2, float("nan")), (3, 0.0), (30, 1.0)]
)
def test_values_out_of_range_are_rejected(unit: Unit, reference: int, value: float) -> None:
    with pytest.raises(Exception, match=r"fmi[23]|3"):  # noqa: PT012  # inputs are judged together, by the step
        unit.set(reference, value)
        unit.step(0.0, 0.01)


def test_the_log_names_the_value_and_the_range(
    tmp_path: Path, written: Written, capsys: pytest.CaptureFixture[str]
) -> None:
    for config, cases in (
        (
            RigConfig(),
            (
                (1, 1e6, 0.01, "frequency must be >= 5 and <= 200 Hz, current must be >= 0 and <= 21.21 A"),
                (1, 1e6, 0.01, ", got 1e+06 Hz and 0"),
                (3, 9.0, 0.01, "gap must be >= 1e-06 and <= 1 m, got 9 m"),
                (30, 1.0, 0.01, "value reference 30 cannot be set: it is neither an input nor a parameter"),
                (1, 9.1, 0.004, "a step must end at a multiple of 10 ms after the present time, got an end at 0.004 s"),
            ),
        ),
        (
            of_samples(1000, "first_order"),
            (
                (2, 1e3, 0.001, "] current must be >= -21.21 and <= 21.21 A"),
                (2, 1e3, 0.001, ", got 0 to 1000"),
                (2, 0.1, 0.0, "a step must last at least 1 ns, got 0 s"),
            ),
        ),
    ):
        path = written(config)
        description = fmpy.read_model_description(str(path))
        folder = fmpy.extract(str(path), str(tmp_path / config.drive.waveform))
        for reference, value, length, said in cases:
            fmu = fmpy.instantiate_fmu(folder, description, "CoSimulation", debug_logging=True)
            fmu.enterInitializationMode()
            fmu.exitInitializationMode()
            with pytest.raises(Exception, match="fmi3"):  # noqa: PT012  # inputs are judged together, by the step
                fmu.setFloat64([reference], [value])
                fmu.doStep(0.0, length)
            assert said in capsys.readouterr().out
            fmu.freeInstance()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"drive.waveform": "random"}, 'drive.waveform must be "sine" or "stream"'),
        ({"instruments.ideal": True}, "instruments.ideal must be false"),
        (
            {"instruments.faults.planned": ["stuck channel=laser"]},
            r'planned must be \[\] .* got \["stuck channel=laser"\]',
        ),
    ],
)
def test_an_impossible_unit_is_rejected(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        snapshot(from_flat(RigConfig(), changes))


@pytest.mark.parametrize(
    ("compiler", "said"),
    [
        ("no_compiler", r"needs a C compiler \(.*no_compiler.*name another in CC"),
        ("false", r"by false \(CC\): exit code 1"),
    ],
)
def test_a_compiler_that_fails_is_named(
    compiler: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", compiler)
    with pytest.raises(ImpactRigError, match=said):
        write_fmu(RigConfig(), tmp_path / "rig.fmu")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_kernels_is_named_with_the_command_that_fills_it(tmp_path: Path) -> None:
    with pytest.raises(ImpactRigError, match=rf"impact_rig\.o is missing: run `.*kernels\.build {tmp_path}`"):
        write_fmu(RigConfig(), tmp_path / "rig.fmu", kernels=tmp_path)


def test_the_script_of_the_page_prints_the_dt_of_the_rig(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = PAGE.read_text(encoding="utf-8")
    script = re.search(r"```python[^\n]*\n(from fmpy.*?)```\n\n```text\n(.*?)```", page, re.DOTALL)
    measures = re.search(r"The rig measures (DT \S+ ± \S+) \(2u\) at this drive", page)
    assert script is not None
    assert measures is not None
    (tmp_path / "rig.fmu").write_bytes(path.read_bytes())
    monkeypatch.chdir(tmp_path)
    exec(script[1], {})
    printed = capsys.readouterr().out
    assert printed == script[2]
    assert str(impact_rig.simulate(20.0)).startswith(measures[1])
    dt, limit = (float(one) for one in measures[1].removeprefix("DT ").split(" ± "))
    assert float(printed.split()[1].rstrip(",")) == pytest.approx(dt, abs=limit)
