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
"""Maps of the mechanics: settled motion of a point, resumption with equal bits, rejections, optimum, pictures."""

from __future__ import annotations

import json
import math
import re
import shutil
from pathlib import Path

import attrs
import numpy as np
import pytest
from matplotlib.colors import to_rgba

from impact_rig.cli.main import main
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.physics.linear_response import base_per_ampere, transmissibility
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.system.budget import BudgetError
from impact_rig_studies import prediction
from impact_rig_studies.campaign.paper import CURRENT_A
from impact_rig_studies.campaign.tasks import measure
from impact_rig_studies.maps import optimum, run
from impact_rig_studies.maps.measure import FAILED, MapRig, Settings
from impact_rig_studies.maps.plan import DOWN, UP, MapLine, MapPlan, load_map, measure_line
from impact_rig_studies.report.heat_map import QUIET, REGIMES, TWO, classes, heat_maps

pytestmark = pytest.mark.heavy

SMALL = """\
title: small
axes:
  gap_m: [0.010, 0.020, 0.026]
  frequency_hz: [9.0, 9.1]
direction: both
optimum: {over: gap_m, from: 0.024, to: 0.034, points: 6}
"""


def written(folder: Path, text: str = SMALL) -> Path:
    path = folder / "map.yaml"
    path.write_text(text)
    return path


def one_by_one(lines):
    yield from ((line, measure_line(line)) for line in lines)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[MapPlan, Path]:
    """Map of 3 × 2 points in both directions, measured by the command."""
    folder = tmp_path_factory.mktemp("map")
    path = written(folder)
    assert main(["map", str(path), "--output", str(folder / "done"), "--workers", "1"]) == 0
    return load_map(path), folder / "done"


def files_of(directory: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (directory / "lines").iterdir()}


@pytest.mark.parametrize("frequency_hz", [8.9, 9.1])
def test_a_point_without_a_sphere_is_the_closed_form(frequency_hz):
    config = from_flat(RigConfig(), {"sphere.present": False})
    found = MapRig(config, Settings(settle_cycles=600)).measure(frequency_hz, CURRENT_A)
    assert found.dt == pytest.approx(abs(complex(transmissibility(config, frequency_hz))), rel=1e-3)
    assert found.base_m == pytest.approx(CURRENT_A * abs(complex(base_per_ampere(config, frequency_hz))), rel=1e-3)
    assert (found.regime, found.period, found.impacts_per_cycle) == ("periodic", 1.0, 0.0)
    assert abs(found.reduction_percent) < 0.1


def test_points_with_two_impacts_per_cycle_agree_with_the_prediction(small):
    plan, directory = small
    values = run.open_map(directory).values[UP]
    place = (list(plan.axes["gap_m"]).index(0.020), list(plan.axes["frequency_hz"]).index(9.1))
    wanted = prediction.at(plan.base, 9.1, 0.020, current_a=CURRENT_A)
    assert values["dt"][place] == pytest.approx(wanted.dt[0], rel=1e-3)
    assert values["phase_rad"][place] == pytest.approx(wanted.phase_rad[0], abs=2e-3)
    assert values["impacts_per_cycle"][place] == 2.0
    assert classes(values)[place] == TWO
    assert {*values["regime"].ravel()} <= {"periodic", "modulated", "chaotic"}


@pytest.mark.parametrize(
    ("gap_m", "frequency_hz", "period"),
    [
        (0.020, 9.1, 1),
        (0.002, 9.1, 1),
        (0.010, 8.905, 2),
        (0.026, 9.595, 3),
        (0.008, 8.695, 4),
        (0.012, 9.115, 1),  # from cycle to cycle it changes little, and goes on to
        (0.008, 9.565, 1),  # an impact occurs at the start of the cycle
    ],
)
def test_a_settled_point_agrees_with_a_long_motion(gap_m, frequency_hz, period):
    """DT agrees within `settle_tolerance`, from a hundredth of the cycles and without samples."""
    rig = MapRig(from_flat(RigConfig(), {"barriers.gap_m": gap_m}), Settings())
    found = rig.measure(frequency_hz, CURRENT_A)
    rig.reset()
    motion = rig.run_cycles(frequency_hz, CURRENT_A, 3000)
    cycles, turn = 24, np.arange(64) / 64
    tick = np.repeat(np.arange(motion.last_tick + 1 - cycles, motion.last_tick + 1), len(turn))
    samples = motion.quantities(("x_b", "x_1"), tick, np.tile(turn / frequency_hz, cycles)).reshape(2, cycles, -1)
    x_b, x_1 = samples @ np.exp(-2j * math.pi * turn)
    assert found.dt == pytest.approx(abs(x_1.mean() / x_b.mean()), rel=Settings().settle_tolerance)
    assert (found.regime, found.period) == ("periodic", period)
    assert (found.impacts_per_cycle * period) % 1.0 == pytest.approx(0.0, abs=1e-9), "impacts per orbit are an integer"
    assert np.abs(x_1[period:] - x_1[:-period]).max() < 1e-6 * np.abs(x_1).mean(), "the long motion does not repeat"
    assert period == 1 or np.abs(x_1[1:] - x_1[:-1]).max() > 1e-4 * np.abs(x_1).mean()


def test_a_motion_that_repeats_after_many_cycles_is_periodic(tmp_path: Path) -> None:
    """At 55 mm, reached from above, 16 impacts in 12 cycles: more cycles than the regime of a measurement considers."""
    text = "{axes: {gap_m: [0.055, 0.0555, 0.056], frequency_hz: [9.1, 9.2]}, sweep: gap_m, direction: down}"
    line = load_map(written(tmp_path, text)).lines()[0]
    found = dict(zip(line.values, measure_line(line), strict=True))[0.055]
    assert (line.held["frequency_hz"], found.regime, found.period) == (9.1, "periodic", 12.0)
    assert found.impacts_per_cycle * 12.0 == pytest.approx(16.0)


def test_impacts_of_an_unsettled_motion_are_counted_over_all_cycles():
    """The amplitude repeats within the tolerance for periodic; the sphere does not, so the motion is chaotic."""
    found = MapRig(from_flat(RigConfig(), {"barriers.gap_m": 0.004}), Settings()).measure(8.725, CURRENT_A)
    assert (found.regime, found.cycles) == ("chaotic", 200.0)
    assert found.impacts_per_cycle * 200.0 == pytest.approx(round(found.impacts_per_cycle * 200.0), abs=1e-9)
    assert found.impacts_per_cycle % 1.0 > 0.1


COEXISTENCE = """
title: coexistence
axes:
  sphere_position_m: [-0.0105, 0.007]
  sphere_speed_m_s: [-0.75, 0.0]
set: {barriers.gap_m: 0.030}
frequency_hz: 9.1
"""


def test_the_start_of_the_sphere_selects_one_of_three_motions(tmp_path):
    """At 30 mm and 9.1 Hz: two impacts per cycle, none, and a third motion that no start at rest reaches."""
    (tmp_path / "map.yaml").write_text(COEXISTENCE)
    found = [reading for line in load_map(tmp_path / "map.yaml").lines() for reading in measure_line(line)]
    assert sorted(round(reading.dt) for reading in found) == [36, 36, 96, 110]
    (third,) = [reading for reading in found if round(reading.dt) == 96]
    assert 2.0 < third.impacts_per_cycle < 3.0


def test_a_sphere_on_its_way_to_a_wall_is_not_at_rest():
    """The structure is as steady as without a sphere for hundreds of cycles, but the sphere drifts and will strike."""
    rig = MapRig(from_flat(RigConfig(), {"barriers.gap_m": 0.040}), Settings())
    rig.reset((0.0, 3e-4))
    found = rig.measure(10.5, CURRENT_A)
    assert (found.impacts_per_cycle, found.regime) == (0.0, "intermittent")
    assert math.isnan(found.period)
    assert abs(found.reduction_percent) < 0.01
    assert len(rig.run_cycles(10.5, CURRENT_A, 1200).impacts) > 0


def test_each_start_of_the_sphere_is_measured_separately(tmp_path):
    path = written(tmp_path, "axes: {gap_m: [0.02, 0.03], frequency_hz: [9.1, 9.2]}\nstarts: [left, centre]\n")
    plan = load_map(path)
    assert plan.layers == ("left", "centre")
    readings = {line.direction: measure_line(line)[0] for line in plan.lines() if 0.03 in line.held.values()}
    assert readings["left"].impacts_per_cycle == 2.0
    assert readings["centre"].impacts_per_cycle == 0.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (COEXISTENCE + "direction: up\n", "sphere_position_m sets how each point starts: direction must then be reset"),
        (COEXISTENCE + "starts: [left]\n", "exclude each other"),
        (
            COEXISTENCE.replace("0.007", "0.016"),
            "sphere_position_m must be >= -0.015 and <= 0.015 m, half the gap, got",
        ),
        (COEXISTENCE.replace("-0.75", "-750"), "sphere_speed_m_s must be >= -100 and <= 100 m/s"),
        (COEXISTENCE.replace("sphere_speed_m_s", "sphere.start"), "use starts: [left, centre, right]"),
        (SMALL.replace("direction: both", "starts: [above]"), "starts must be one of left, centre, right"),
    ],
)
def test_an_impossible_start_is_rejected(tmp_path, text, words):
    with pytest.raises(ConfigError, match=re.escape(words)):
        load_map(written(tmp_path, text))


def test_an_interrupted_map_resumes_to_the_same_bits(small, tmp_path):
    plan, directory = small
    kept = run.store(tmp_path / "again")
    kept.prepare(plan.text, plan.base)
    lines = plan.lines()
    measured = measure(lines, kept.get, kept.put, one_by_one)
    next(measured)
    measured.close()
    assert len(files_of(tmp_path / "again")) == 1
    again = [line for line, _ in measure(lines, kept.get, kept.put, one_by_one)]
    assert len(again) == len(lines) == 6
    assert files_of(tmp_path / "again") == files_of(directory)


def test_a_map_of_another_rig_is_not_replaced(small, tmp_path):
    plan, _ = small
    run.store(tmp_path).prepare(plan.text, plan.base)
    run.store(tmp_path).prepare(plan.text, plan.base)
    with pytest.raises(RecordingError, match=re.escape("results of a rig with sphere.present True, not False")):
        run.store(tmp_path).prepare(plan.text, from_flat(plan.base, {"sphere.present": False}))


def test_a_damaged_line_or_one_of_other_code_is_measured_again(small, tmp_path):
    plan, directory = small
    run.store(tmp_path).prepare(plan.text, plan.base)
    line = plan.lines()[0]
    name = f"{line.key}.json"
    good = json.loads(files_of(directory)[name])
    for spoilt in ("{", json.dumps({**good, "code": "other"}), json.dumps({**good, "rows": [[1], [2]]})):
        (tmp_path / "lines" / name).write_text(spoilt)
        store = run.store(tmp_path)
        assert store.get(line) is None
        assert store.get(line) is None
        assert len(store.damaged) == ("other" not in spoilt)
    for value, shown in ((True, "True"), (math.inf, "inf"), (10**400, "a number too large"), ([1], r"\[1\]")):
        (tmp_path / "lines" / name).write_text(json.dumps({**good, "rows": [[value]]}))
        store = run.store(tmp_path)
        assert store.get(line) is None
        assert re.search(f"a stored value must be a finite number, null or text, got {shown}", store.damaged[0])
    for other in ([], {**good, "rows": 3}, {**good, "rows": [3]}):
        (tmp_path / "lines" / name).write_text(json.dumps(other))
        store = run.store(tmp_path)
        assert store.get(line) is None
        assert store.damaged[0].endswith("is damaged, changed or unreadable: its JSON is not that of a result")
    (tmp_path / "lines" / name).write_text(json.dumps(good))
    assert run.store(tmp_path).get(line) == measure_line(line)


def test_a_damaged_line_is_reported_when_it_is_measured_again(small, tmp_path, capsys):
    _, directory = small
    copied = tmp_path / "map"
    shutil.copytree(directory, copied)
    damaged = next((copied / "lines").iterdir())
    damaged.write_text("{")
    assert main(["map", str(copied / "map.yaml"), "--output", str(copied), "--no-figures"]) == 0
    shown = "".join(capsys.readouterr().out.split())  # lines are wrapped
    assert f"{damaged.name},astoredresult,isdamaged,changedorunreadable:Expectingpropertyname" in shown
    assert "itwasmeasuredagain" in shown
    json.loads(damaged.read_text())


def test_a_downward_line_starts_at_its_highest_value(small):
    plan, _ = small
    up, down = (next(line for line in plan.lines() if line.direction == one) for one in (UP, DOWN))
    assert up.values == (9.0, 9.1)
    assert down.values == (9.1, 9.0)
    assert up.key != down.key


def test_the_best_gap_agrees_with_the_prediction(small):
    _, directory = small
    best = json.loads((directory / "map.json").read_text())["optimum"]
    predicted = prediction.best_gap(prediction.branch(RigConfig(), 9.1, current_a=CURRENT_A))
    assert best["value"] == pytest.approx(float(predicted.gap_m[0]), abs=1e-3)
    assert best["region"][0] < best["value"] < best["region"][1]
    assert best["points_per_percent"]["gap_m"] == pytest.approx(0.0, abs=0.02)
    assert best["points_per_percent"]["sphere.density_kg_m3"] > 0.1


def test_the_sensitivities_of_an_optimum_are_computed_at_the_end_of_a_range(tmp_path):
    """At e = 1, the sensitivity is the difference to a smaller e.

    A larger e, such as 1.005, is not allowed, and must not fail the optimum after all measurements.
    """
    search = "optimum: {over: gap_m, from: 0.0279, to: 0.0281, points: 5}\nset: {contact.restitution: 1.0}"
    plan = load_map(written(tmp_path, f"{search}\naxes: {{gap_m: [0.01, 0.02], current_a: [0.4, 0.5]}}"))
    best = optimum.find(plan, plan.search)

    def reduction(e: float) -> float:
        config = from_flat(plan.base, {"barriers.gap_m": best.value, "contact.restitution": e})
        return MapRig(config, plan.settings).measure(plan.frequency_hz, plan.current_a).reduction_percent

    assert best.points_per_percent["contact.restitution"] == (reduction(1.0) - reduction(0.995)) / 0.5
    assert np.isfinite(list(best.points_per_percent.values())).all()


def test_the_optimum_of_a_map_is_reported_with_its_neighbours():
    assert optimum.from_map([10.0, 49.5, 50.0, 49.2, 30.0], [1, 2, 3, 4, 5]) == (3.0, (2.0, 4.0))


@pytest.fixture(scope="module")
def drawn(small):
    """The heat maps of the small map."""
    return tuple(heat_maps(run.open_map(small[1])))


def test_table_and_figures_are_written(small, drawn):
    _, directory = small
    rows = (directory / "map.csv").read_text().splitlines()
    assert rows[0].startswith("gap_m,frequency_hz,direction,start,regime,dt,reduction_percent")
    assert len(rows) == 1 + 12
    assert {path.name for path in (directory / "figures").glob("*.svg")} == {
        "map_up.svg", "map_down.svg", "map_up_down.svg",
    }  # fmt: skip
    up, _, _ = drawn
    assert "two impacts per cycle" in up.svg
    assert "predicted" in up.svg


def test_each_cell_of_a_map_has_the_colour_of_its_regime(small, drawn):
    """Outlines of neighbouring regimes would hide one another, and be invisible on cells of a similar colour."""
    done = run.open_map(small[1])
    up, _, _ = drawn
    (cells,) = up._figure.axes[1].collections
    wanted = [to_rgba(REGIMES[group][1]) for group in classes(done.values[UP]).T.ravel().tolist()]
    assert cells.to_rgba(cells.get_array()).reshape(-1, 4).tolist() == [list(colour) for colour in wanted]


def test_the_colours_of_regimes_differ_for_any_colour_vision():
    """The lightness L* (CIE 1976) of any two colours differs by at least 10."""
    linear = [
        [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgba(one)[:3]]
        for _, one in REGIMES.values()
    ]
    light = sorted(116.0 * np.cbrt(np.array(linear) @ [0.2126, 0.7152, 0.0722]) - 16.0)
    assert np.diff(light).min() > 10.0


def test_exponents_stay_in_the_results_of_a_later_command(tmp_path: Path) -> None:
    """The same command without `--exponent` must not drop their columns."""
    path = written(tmp_path, "axes: {gap_m: [0.002, 0.006], frequency_hz: [9.1, 9.2]}\n")
    command = ["map", str(path), "--output", str(tmp_path / "done"), "--workers", "1", "--no-figures"]
    assert main([*command, "--exponent"]) == 0
    table = (tmp_path / "done" / run.CSV_FILE).read_text(encoding="utf-8")
    names, *rows = (line.split(",") for line in table.splitlines())
    exponents = [row[names.index("exponent_per_s")] for row in rows]
    assert exponents[:3] == ["", "", ""], "a periodic motion has none"
    assert float(exponents[3]) > 1.0, "a chaotic one"
    assert main(command) == 0
    assert (tmp_path / "done" / run.CSV_FILE).read_text(encoding="utf-8") == table
    assert json.loads((tmp_path / "done" / run.JSON_FILE).read_text(encoding="utf-8"))["exponents"] == 1


def test_points_are_exported(small, tmp_path, capsys):
    parquet = pytest.importorskip("pyarrow.parquet")
    _, directory = small
    assert main(["export", str(directory), "points", str(tmp_path / "map.parquet")]) == 0
    table = parquet.read_table(tmp_path / "map.parquet")
    assert table["dt"].to_numpy()[0] == run.open_map(directory).values[UP]["dt"][0, 0]
    assert table["regime"].to_pylist()[0] == "periodic"
    assert main(["export", str(directory), "curve", str(tmp_path / "map.csv")]) == 1
    assert f"{directory} has no table 'curve'; it has the tables points" in capsys.readouterr().err


def test_a_map_becomes_a_data_frame_and_a_dataset(small):
    pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    done = run.open_map(small[1])
    frame, dataset = done.to_dataframe(), done.to_xarray()
    with (small[1] / "map.csv").open() as file:
        assert list(frame.columns) == file.readline().strip().split(",")
    assert dict(dataset.sizes) == {"gap_m": 3, "frequency_hz": 2, "direction": 2}
    for _, row in frame.iterrows():
        place = dataset.sel(gap_m=row["gap_m"], frequency_hz=row["frequency_hz"], direction=row["direction"])
        assert (float(place["dt"]), str(place["regime"].item())) == (row["dt"], row["regime"])
    assert set(frame["start"]) == {small[0].base.sphere.start}


def test_the_start_of_the_sphere_is_a_column_of_the_table(tmp_path):
    path = tmp_path / "map.yaml"
    path.write_text("axes: {gap_m: [0.006, 0.008], current_a: [0.5, 0.52]}\nstarts: [left, right]\n")
    assert main(["map", str(path), "--workers", "1", "--no-figures", "--output", str(tmp_path / "out")]) == 0
    frame = run.open_map(tmp_path / "out").to_dataframe()
    assert sorted(set(zip(frame["direction"], frame["start"], strict=True))) == [("reset", "left"), ("reset", "right")]
    assert dict(run.open_map(tmp_path / "out").to_xarray().sizes) == {"gap_m": 2, "current_a": 2, "start": 2}


def test_an_unresolvable_motion_is_marked_as_failed(monkeypatch):
    from impact_rig.errors import SimulationError
    from impact_rig.physics import Simulation

    def fail(*_):
        raise SimulationError("stuck")

    rig = MapRig(RigConfig(), Settings())
    monkeypatch.setattr(Simulation, "advance", fail)
    found = rig.measure(9.1, CURRENT_A)
    assert found.regime == FAILED
    assert math.isnan(found.dt)


def test_motions_without_impacts_are_a_separate_class():
    values = {"regime": np.array(["periodic", ""]), "impacts_per_cycle": np.zeros(2), "period": np.array([1.0, np.nan])}
    assert classes(values).tolist() == [QUIET, 5]


@pytest.mark.parametrize("third", ["current_a: [0.4, 0.52]", "sphere_position_m: [0.0, 0.001]"])
def test_a_map_with_three_axes_has_a_picture_per_value(tmp_path, third):
    plan = load_map(written(tmp_path, f"axes: {{gap_m: [0.01, 0.02], frequency_hz: [9.0, 9.1], {third}}}\n"))
    assert plan.points == 8
    assert len(plan.lines()) == 4
    assert plan.sweep == "frequency_hz"
    run.store(tmp_path / "out").prepare(plan.text, plan.base)
    drawn = list(heat_maps(run.finished(plan, tmp_path / "out")))
    assert [one.name for one in drawn] == ["map_reset_0", "map_reset_1"]


SEARCH = "optimum: {{over: {}, from: {}, to: {}}}\naxes: {{gap_m: [0.01, 0.02], current_a: [0.4, 0.5]}}"
"""A wrong end of the search must be rejected before the map is measured."""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("axes: {gap_m: [0.01, 0.02]}", "axes must be two or three"),
        ("axes: {gap_m: [0.01, 0.02], speed: [1, 2]}", "unknown axis 'speed'"),
        ("axes: {gap_m: [0.01, 0.02], frequency_hz: [9, 9.1]}\nfrequency_hz: 9", "is an axis"),
        ("axes: {gap_m: [0.01, 0.02], daq.seed: [1, 2]}", "has no effect on a map"),
        ("axes: {gap_m: [0.01, 0.02], contact.restitution: [0.1, 3]}", "restitution"),
        ("axes: {barriers.gap_m: [0.01, 0.02], frequency_hz: [9, 9.1]}", "use gap_m"),
        ("axes: {gap_m: [0.01, 0.02], frequency_hz: [-9, 9.1]}", "must be > 0"),
        ("axes: {gap_m: [0.01, 0.02], frequency_hz: [9, 9.1]}\nmeasure: {cycles: 1}", "measure.cycles"),
        ("axes: {gap_m: [0.01, 0.02], frequency_hz: [9, 9.1]}\nsweep: current_a", "sweep must be one of"),
        ("axes: {gap_m: [0.01, 0.02], frequency_hz: 9}", "two values or more"),
        ("optimum: 1\naxes: {gap_m: [0.01, 0.02], frequency_hz: [9, 9.1]}", "optimum must be a mapping"),
        (
            "optimum: {over: gap, from: 1, to: 2}\naxes: {gap_m: [0.01, 0.02], frequency_hz: [9, 9.1]}",
            "optimum.over: unknown axis 'gap'",
        ),
        (SEARCH.format("contact.restitution", 0.5, 2), "contact.restitution must be .* <= 1, got 2"),
        (SEARCH.format("contact.rest", 0.5, 0.6), "unknown key 'contact.rest'"),
        (SEARCH.format("gap_m", "1.0e-7", 0.02), "barriers.gap_m must be"),
        (SEARCH.format("sphere_position_m", 0.001, 0.5), "sphere_position_m must be"),
        ("axes: [", "cannot be read as plain YAML"),
    ],
)
def test_an_invalid_file_is_rejected_by_name(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        load_map(written(tmp_path, text))


def test_a_map_that_would_take_too_long_is_rejected_with_its_time(tmp_path, monkeypatch):
    text = "axes: {gap_m: {from: 0.001, to: 0.04, step: 0.00001}, frequency_hz: {from: 8, to: 10, step: 0.001}}\n"
    with pytest.raises(BudgetError, match=r"7805901 points would take about 4\.3 h on 2 cores, more than 1 h; .*=N"):
        load_map(written(tmp_path, text), workers=2)


def test_a_finished_map_can_be_opened_on_any_machine(small, tmp_path, monkeypatch):
    """Points that are already measured cost no time, so the time limit does not apply to them."""
    plan, directory = small
    monkeypatch.setattr("impact_rig_studies.maps.plan.LIMIT_S", 1e-6)
    with pytest.raises(BudgetError):
        load_map(written(tmp_path))
    assert run.open_map(directory).plan.points == plan.points


def test_a_directory_with_other_files_is_not_touched(small, tmp_path):
    plan, _ = small
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(RecordingError, match=r"is not empty and has no map\.yaml"):
        run.store(tmp_path).prepare(plan.text, plan.base)
    with pytest.raises(ConfigError, match="holds no results of `impact-rig map`"):
        run.open_map(tmp_path)


def test_a_line_describes_its_values_and_has_its_own_key(small):
    plan, _ = small
    line = plan.lines()[0]
    assert line.describe() == "gap_m 0.01, up"
    assert isinstance(attrs.evolve(line, current_a=0.4), MapLine)
    assert attrs.evolve(line, current_a=0.4).key != line.key
