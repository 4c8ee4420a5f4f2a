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
"""Excitation by a stream reaches its target, and its estimate agrees with the closed form."""

from __future__ import annotations

import functools
import math
import re
from pathlib import Path

import attrs
import numpy as np
import pytest
from kits.recorded_rig import record

from impact_rig.blocks import Table
from impact_rig.driver import Hardware, LocalRig
from impact_rig.driver.hardware import Exchange
from impact_rig.errors import CommandError, ConfigError, RecordingError
from impact_rig.instruments.fault import Fault
from impact_rig.physics.linear import constants, input_vectors, state_matrix
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig_studies.excitation.files import history, load
from impact_rig_studies.excitation.history import BURSTS, Replicated, ReplicatePlan, _steadying, play, replicate
from impact_rig_studies.excitation.random import RandomPlan, control
from impact_rig_studies.excitation.response import Response, measure
from impact_rig_studies.excitation.shock import Pulse, half_sine_spectrum, shock_response_spectrum
from impact_rig_studies.excitation.signals import BURST, CHIRP, PSEUDO, Excitation
from impact_rig_studies.report.excitation import tell
from qualification.true_motion import MOST, accelerometer, replicated, shocked

pytestmark = pytest.mark.heavy

X_B = 2
RATE_HZ = 2_000


def hardware(**values: object) -> Hardware:
    """Return the hardware of a rig in this process, with configuration values by keys with `__` for the point."""
    settings = {
        "drive.waveform": "stream", "drive.stream_rate_hz": RATE_HZ,
        "daq.rate_hz": RATE_HZ, "daq.block_scans": RATE_HZ // 2,  # long ones: a block costs as much as what is in it
    }  # fmt: skip
    given = {name.replace("__", "."): value for name, value in values.items()}
    return Hardware(LocalRig(settings | given))


def test_each_scan_belongs_to_the_sample_played_with_it():
    linear = hardware(sphere__present=False, instruments__ideal=True, daq__block_scans=100)
    exchange = Exchange(linear, 100)
    samples = np.random.default_rng(1).uniform(-0.1, 0.1, 1_000)
    parts = [exchange.exchange(part) for part in np.split(samples, 10)]
    played, rows = (np.concatenate(one) for one in zip(*parts, strict=True))
    assert np.array_equal(played, np.append(np.zeros(100), samples[:-100]))
    assert np.abs(rows["current"] - played).max() < 1e-9
    assert linear.acquisition.delay_s(0, 0) == 0.0


def test_reading_without_a_played_signal_ends_at_its_timeout():
    waiting = hardware(daq__block_scans=100)
    waiting.acquisition.start(waiting.output.start())
    waiting.output.write(np.zeros(150))
    assert len(waiting.acquisition.read(100)) == 100
    with pytest.raises(TimeoutError, match="200 scans"):
        waiting.acquisition.read(200, timeout_s=0.1)
    waiting.output.stop()
    assert len(waiting.acquisition.read(200)) == 200


SLOW = pytest.mark.slow


# the other kinds of excitation are measured with the sphere (burst) and by the accelerometer (chirp)
@pytest.mark.parametrize("kind", [PSEUDO, *(pytest.param(kind, marks=SLOW) for kind in (BURST, CHIRP))])
def test_a_frequency_response_is_within_its_uncertainty_of_the_closed_form(kind):
    rig = hardware(sphere__present=False)
    *_, found = measure(rig, Excitation(kind=kind), "base")
    lines = (found.coherence > 0.9) & (found.frequency_hz > 4.0) & (found.frequency_hz < 60.0)
    assert np.count_nonzero(lines) > 400
    off = (found.h1 / linear_response(rig, found.frequency_hz) - 1.0)[lines]
    for part in (np.abs(1.0 + off) - 1.0, np.angle(1.0 + off)):
        assert np.mean(np.abs(part) < 2.0 * found.u_relative[lines]) >= 0.95


def test_the_frequency_response_with_the_sphere_agrees_with_the_linear_rig():
    """Only lines with a coherence above 0.9 count, because the sphere disturbs the others."""
    rig = hardware()
    *_, found = measure(rig, Excitation(), "base")
    lines = (found.coherence > 0.9) & (found.frequency_hz > 4.0) & (found.frequency_hz < 60.0)
    off = np.abs(found.h1 / linear_response(rig, found.frequency_hz))[lines] - 1.0
    assert np.mean(np.abs(off) < 2.0 * found.u_relative[lines]) >= 0.95


def test_the_random_error_covers_the_deviations_of_ideal_instruments_with_noise():
    """Many frames of few lines: the scatter of the estimates agrees with their stated uncertainty."""
    rig = hardware(sphere__present=False)
    excitation = Excitation(frames=6, frame_s=4.0, low_hz=20.0)
    estimates = [list(measure(rig, attrs.evolve(excitation, seed=seed), "base"))[-1] for seed in range(8)]
    lines = (estimates[0].frequency_hz > 25.0) & (estimates[0].frequency_hz < 55.0)
    spread = np.std([one.h1[lines].real for one in estimates], axis=0, ddof=1)
    gain = 4e-3  # of the sensors: the same in all
    stated = np.mean([np.sqrt(np.maximum(one.u_relative[lines] ** 2 - gain**2, 0.0)) * np.abs(one.h1[lines])
                    for one in estimates], axis=0)  # fmt: skip
    assert 0.8 < np.sqrt(np.mean(spread**2) / np.mean(stated**2)) < 1.05


def linear_response(rig: Hardware, frequency_hz: np.ndarray) -> np.ndarray:
    """Base over current in closed form."""
    c = constants(rig.rig.config)
    matrix, b = state_matrix(c, "current", c.m_1), input_vectors(c, "current", c.m_1)[0]
    return np.array([np.linalg.solve(2j * np.pi * f * np.eye(4) - matrix, b)[X_B] for f in frequency_hz])


def test_random_control_holds_a_density_of_the_base_acceleration():
    """Within 1 dB on 95 % of the lines from 5 to 200 Hz, with 60 averages; the remaining error is not distortion."""
    *_, found = control(hardware(sphere__present=False), RandomPlan())
    assert found.within(1.0) >= 0.95
    assert found.kurtosis == pytest.approx(3.0, abs=0.3)
    assert found.share(found.distortion) < 5e-3
    assert found.loops[-1] < found.loops[0]


def test_random_control_ends_at_a_trip_and_keeps_its_results():
    rig = hardware(sphere__present=False, shaker__travel_limit_m=2e-4)
    kept = []
    with pytest.raises(CommandError, match="over_travel"):
        kept.extend(control(rig, RandomPlan(averages=4)))
    rig.output.stop()


def test_a_reading_beyond_the_abort_limit_ends_a_test():
    rig = Hardware(hardware(sphere__present=False).rig, {"base": 1e-5})
    with pytest.raises(CommandError, match=r"aborted: base reads .*, beyond the limit ±1e-05 m, at scan"):
        list(control(rig, RandomPlan(averages=4)))


@pytest.mark.parametrize("test", ["frf", "random", "replicate", "play"])
def test_a_test_that_lost_scans_ends_with_that_reason(test):
    """Scans are one to one with samples: after a gap, the rest would belong to other samples."""
    rig = hardware(sphere__present=False)
    rig.rig.inject(Fault(kind="lost_block", start_sample=2 * RATE_HZ, samples=RATE_HZ))
    samples = 0.05 * np.sin(2.0 * np.pi * 9.0 * np.arange(4 * RATE_HZ) / RATE_HZ)
    work = {
        "frf": lambda: measure(rig, Excitation(kind=PSEUDO, frame_s=1.0, frames=4), "accelerometer"),
        "random": lambda: control(rig, RandomPlan(frame_s=1.0, frames=4)),
        "replicate": lambda: replicate(rig, 1e-3 * samples, ReplicatePlan(identify_s=1.0), print),
        "play": lambda: play(rig, samples),
    }
    with pytest.raises(CommandError, match=r"\d+ of \d+ scans were lost, but this test needs every scan"):
        list(work[test]())


@pytest.mark.parametrize(
    ("work", "says"),
    [
        (lambda rig: control(rig, RandomPlan(frame_s=1e-4)), r"frame_s must be at least 0\.002 s"),
        (lambda rig: control(rig, RandomPlan(frame_s=0.004)), "frame_s must be longer: with 0.004 s .* 250 Hz apart"),
        (lambda rig: replicate(rig, np.ones(9), ReplicatePlan(identify_s=1e-5), print), "identify_s must be at least"),
    ],
)
def test_settings_too_short_for_the_rate_are_rejected_before_anything_is_played(work, says):
    rig = hardware(sphere__present=False)
    with pytest.raises(ConfigError, match=says):
        list(work(rig))
    assert rig.rig.sample == 0


def test_the_shock_response_spectrum_of_a_half_sine_is_the_closed_form():
    rate_hz, duration_s = 200_000, 11e-3
    pulse = np.sin(np.pi * np.arange(round(duration_s * rate_hz) + 1) / (duration_s * rate_hz))
    frequency = np.geomspace(5.0, 1_000.0, 60)
    found = shock_response_spectrum(pulse, rate_hz, frequency, quality=1e9)
    assert found == pytest.approx(half_sine_spectrum(1.0, duration_s, frequency), rel=0.01)


def test_a_compensated_pulse_ends_without_speed_or_displacement():
    pulse, rate_hz = Pulse(), 10_000
    acceleration, moved = pulse.acceleration(rate_hz), pulse.displacement(rate_hz)
    assert acceleration.max() == pytest.approx(pulse.peak, rel=1e-3)
    assert abs(acceleration.sum()) / rate_hz < 1e-12
    assert abs(moved[-1]) < 1e-12 < np.abs(moved).max()


@functools.cache
def replication(response, sphere):
    """Return the stated result, the true error and the true motion of the last trial, and the reported steps."""
    steps = []
    short = {"seconds": 2, "identify_s": 16.0, "burst_s": 5.0}  # the structure stops ringing within 16 s
    return *replicated(response, sphere=sphere, seed=1, on_step=steps.append, **short), steps


@pytest.mark.parametrize(
    ("response", "sphere"),
    [
        (Response.BASE, False),
        (Response.SUPERIOR, True),
        pytest.param(Response.BASE, True, marks=SLOW),
        pytest.param(Response.SUPERIOR, False, marks=SLOW),
    ],
)
def test_the_error_of_a_replicated_history_agrees_with_the_stated_one(response, sphere):
    """The sensor's lag must be corrected: the reading may follow to 0.36 % while the base is wrong by 3.0 %.

    With the sphere, equal trials differ by up to 1.2 % unless each begins with the same motion of the sphere. Only
    then is the error of a repetition the stated one.
    """
    stated, error, *_ = replication(response, sphere)
    assert len(stated.errors) <= 6
    assert stated.relative(stated.reached - stated.asked) == pytest.approx(min(stated.errors))
    assert min(stated.errors) <= MOST
    assert error <= min(stated.errors) + stated.floor
    assert stated.floor < 0.01
    assert (stated.burst > 0) is sphere
    assert stated.repeated == pytest.approx(min(stated.errors), rel=0.1)
    assert not stated.drive[stated.quiet].any()


def test_a_burst_exceeds_neither_the_drive_nor_the_motion_of_the_history():
    """A specimen must not be shaken harder than its user asked. The user reads why the bursts are played."""
    found, _, truth, steps = replication(Response.SUPERIOR, True)
    for values in (found.drive, truth["x_1"]):  # both of the repetition of the best trial
        size = np.abs(values)
        assert 0.0 < size[: found.burst].max() <= 1.02 * size[found.burst :].max()
    assert steps[0] == "response function measured"
    assert re.fullmatch(r"[2-5] equal trials without a burst differ by [\d.]+ % of the history", steps[1])
    assert re.fullmatch(r"5 equal trials after a burst of [\d.]+ A peak differ by 0\.\d+ % of the history", steps[-1])


@pytest.mark.parametrize(
    ("agree_below", "chosen"),
    [(1.9, 0.8 * 2.0), (1.1, 0.5 * 2.0), (0.0, 0.64 * 2.0)],
    ids=["the first that agrees", "a later one", "none agrees: the one of least scatter"],
)
def test_bursts_become_weaker_until_equal_trials_agree(agree_below, chosen):
    """Trials after a burst below a limit agree; those after other bursts scatter, after one of 1.28 A the least."""
    random, drive, played = np.random.default_rng(1), np.ones(40), []

    def respond(burst, by):
        peak = np.abs(burst).max(initial=0.0)
        played.append((peak, by[0]))
        scatter = 0.001 if 0.0 < peak < agree_below else 0.1 if peak == pytest.approx(1.28) else 10.0
        return scatter * random.standard_normal(40)

    steps = []
    found = _steadying(respond, drive, 2.0 * np.ones(10), 0.01, steps.append)
    assert np.abs(found).max() == pytest.approx(chosen)
    peaks = list(dict.fromkeys(peak for peak, _ in played))
    assert peaks == pytest.approx([2.0 * one for one in BURSTS if not agree_below or one == 0 or 2.0 * one >= chosen])
    assert len(steps) == len(peaks)
    if agree_below:
        equal = [by for peak, by in played if peak == pytest.approx(chosen)]
        assert equal == pytest.approx([1.0, 0.9, 1.0, 0.8, 1.0, 0.7, 1.0, 0.6, 1.0]), "five, with others between them"


@pytest.mark.parametrize(("repeated", "says"), [(0.0041, False), (0.012, True)])
def test_an_error_below_that_of_a_repetition_is_called_chance(repeated, says):
    wave = np.sin(np.arange(4_000) / 20.0)
    found = Replicated(
        rate_hz=2_000, asked=wave, reached=1.004 * wave, linear=wave, drive=wave, burst=0, lead=0, errors=(0.01, 0.004),
        floor=0.004, repeated=repeated,
    )  # fmt: skip
    summary = tell(found, "m")
    assert summary.figures["error_repeated"] == repeated
    assert f"has an error of {100 * repeated:.2f} %" in summary.sentences[0]
    assert ("is chance" in summary.sentences[0]) is says
    assert "repetition" not in tell(attrs.evolve(found, repeated=None), "m").sentences[0]


def test_the_base_makes_a_half_sine_and_the_stated_figures_are_true():
    stated, true = shocked(1)
    assert abs(true["peak_error"]) < 0.01
    assert abs(true["velocity_error"]) < 0.005
    assert abs(true["left_m"]) < 2e-6
    for name, value in true.items():
        assert abs(getattr(stated, name) - value) <= stated.floors[name], name
    assert stated.floors["srs_worst_db"] < 3.0


def test_the_high_pass_of_the_accelerometer_is_corrected():
    """At 4.5 Hz, the high-pass turns the phase by 12 degrees."""
    share, lines = accelerometer(CHIRP, 1)
    assert lines > 100
    assert share >= 0.92


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("peak: 20\nduraton_s: 0.01", r"unknown key duraton_s: did you mean duration_s\? \(.*plan.yaml\)"),
        ("peak: -1", r"peak.*plan.yaml"),
        (f"peak: 0x{'f' * 500}", r"peak must be a number, got .*plan.yaml"),
        ("peak: [1]", r"peak must be a number, got \[1\] \(.*plan.yaml\)"),
        ("- 1", r"a mapping is needed"),
    ],
)
def test_an_invalid_plan_is_rejected_with_key_and_file(tmp_path, text, says):
    file = tmp_path / "plan.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=says):
        load(file, Pulse)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"frame_s": 1e-4}, r"frame_s must be at least 0\.002 s, 4 samples at 2000 Hz, got 0\.0001 s"),
        ({"burst": 1e-4}, r"burst \* frame_s must be at least 0\.002 s"),
        ({"kind": CHIRP, "frame_s": 1e-3}, r"frame_s must be at least 0\.002 s, .*, got 0\.001 s"),
        (
            {"kind": PSEUDO, "frame_s": 0.1, "low_hz": 11.0, "high_hz": 19.0},
            "none is between low_hz = 11 and high_hz = 19",
        ),
    ],
)
def test_a_signal_too_short_for_its_rate_or_band_is_rejected(values, says):
    with pytest.raises(ConfigError, match=says):
        Excitation(**values).samples(RATE_HZ)


@pytest.mark.parametrize("values", [{"duration_s": 1e-4}, {"compensation_s": 1e-5}])
def test_a_pulse_too_short_for_its_rate_is_rejected(values):
    with pytest.raises(ConfigError, match=r"must be at least 0\.002 s, 4 samples at 2000 Hz"):
        Pulse(**values).displacement(RATE_HZ)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{frequency_hz: [5, 10]}", "spectrum: missing: density"),
        ("{frequency_hz: [5, 10], densty: [1, 1]}", "spectrum: unknown key densty: did you mean density"),
        ("{frequency_hz: [5, 10, 20], density: [1, 1]}", "spectrum: density must have as many values"),
        ("{frequency_hz: [10, 5], density: [1, 1]}", "spectrum: frequency_hz must be ascending, got 5 after 10"),
        ("1", "spectrum: a mapping is needed"),
        ("{frequency_hz: [true, 10], density: [1, 1]}", "spectrum: frequency_hz must be a list of numbers"),
    ],
)
def test_an_invalid_spectrum_is_rejected_with_its_key(tmp_path, text, says):
    file = tmp_path / "plan.yaml"
    file.write_text(f"spectrum: {text}")
    with pytest.raises(ConfigError, match=says):
        load(file, RandomPlan)


def test_the_installed_plans_are_the_defaults():
    folder = Path(__file__).parents[2] / "config" / "excitation"
    assert load(folder / "shock.yaml", Pulse) == Pulse()
    assert load(folder / "random.yaml", RandomPlan) == RandomPlan()
    assert load(folder / "replicate.yaml", ReplicatePlan) == ReplicatePlan()


def test_a_history_of_any_file_is_in_si_units_at_the_rate_of_the_rig(tmp_path):
    t = np.arange(2_500) / 1_250
    wave = 3.0 * np.sin(2.0 * np.pi * 9.0 * t) * np.hanning(len(t))
    np.savez(tmp_path / "a.npz", drive=wave, other=t, fs=1_250.0)
    (tmp_path / "a.csv").write_text(
        "time (s),drive (mA)\n" + "".join(f"{a:.9f},{1e3 * b:.9g}\n" for a, b in zip(t, wave, strict=True))
    )
    at = np.arange(4_000) / 2_000
    exact = 3.0 * np.sin(2.0 * np.pi * 9.0 * at) * np.interp(at, t, np.hanning(len(t)))
    for name in ("a.npz", "a.csv"):
        found = history(tmp_path / name, 2_000, "A", "drive")
        assert len(found) == 4_000
        assert np.abs(found - exact)[100:-100].max() < 0.01
    with pytest.raises(ConfigError, match=r"the file states .* samples per second: omit --file-rate"):
        history(tmp_path / "a.csv", 2_000, "A", "drive", file_hz=625.0)
    with pytest.raises(ConfigError, match="has several signals"):
        history(tmp_path / "a.npz", 2_000, "A")
    with pytest.raises(ConfigError, match="'mA' cannot be converted to m"):
        history(tmp_path / "a.csv", 2_000, "m", "drive")


@pytest.mark.parametrize("file_hz", [3_000.0, 1.5e6, 7e6])
def test_a_history_of_any_rate_keeps_its_length(tmp_path, file_hz):
    """A reduction of the rate by more than a thousand must neither add length nor raise an error."""
    np.savez(
        tmp_path / "a.npz", drive=np.sin(2.0 * np.pi * 9.0 * np.arange(round(0.2 * file_hz)) / file_hz), fs=file_hz
    )
    found = history(tmp_path / "a.npz", 1_000, "A", "drive")
    assert len(found) == 200
    assert np.abs(found - np.sin(2.0 * np.pi * 9.0 * np.arange(200) / 1_000))[20:-20].max() < 0.01


def test_a_response_without_a_sensor_cannot_follow_a_history(tmp_path):
    (tmp_path / "plan.yaml").write_text("response: base_acceleration")
    with pytest.raises(
        ConfigError,
        match=r"\(base, superior, superior_acceleration\), got base_acceleration, which is computed \(.*plan",
    ):
        load(tmp_path / "plan.yaml", ReplicatePlan)


def test_times_with_a_gap_are_not_played_as_even_ones(tmp_path):
    even = [f"{k / 1000:.2f},{k % 7}" for k in range(400)]  # rounded to ten periods
    (tmp_path / "even.csv").write_text("\n".join(["time [s],drive [A]", *even]))
    assert len(history(tmp_path / "even.csv", 1_000, "A", "drive")) == pytest.approx(400, abs=20)
    lacking = [f"{k / 1000},{k % 7}" for k in range(400) if not 100 <= k < 102]
    (tmp_path / "lacking.csv").write_text("\n".join(["time [s],drive [A]", *lacking]))
    with pytest.raises(ConfigError, match="not evenly spaced: the one of value 101 is"):
        history(tmp_path / "lacking.csv", 1_000, "A", "drive")
    rows = [f"{t},{k}" for k, t in enumerate((0.0, 0.1, 0.2, 0.3, 5.0, 5.1))]
    (tmp_path / "gap.csv").write_text("\n".join(["time [s],drive [A]", *rows]))
    with pytest.raises(
        ConfigError, match=r"gap\.csv: the times are not evenly spaced: the one of value 4 is 2.76 s off"
    ):
        history(tmp_path / "gap.csv", 1_000, "A", "drive")
    for times in ([0.3, 0.2, 0.1], [0.3, 0.3, 0.3]):
        (tmp_path / "back.csv").write_text(
            "\n".join(["time [s],drive [A]", *(f"{t},{k}" for k, t in enumerate(times))])
        )
        for file_hz in (None, 100.0):
            with pytest.raises(ConfigError, match=r"the times do not increase: .* --file-rate HZ$"):
                history(tmp_path / "back.csv", 1_000, "A", "drive", file_hz=file_hz)
    (tmp_path / "back.csv").write_text("drive [A]\n0\n1\n2")
    assert len(history(tmp_path / "back.csv", 1_000, "A", "drive", file_hz=100.0)) == 30
    for file_hz in (0.0, -5.0, math.inf, math.nan):
        with pytest.raises(ConfigError, match=f"--file-rate must be > 0 Hz and finite, got {file_hz:g}"):
            history(tmp_path / "back.csv", 1_000, "A", "drive", file_hz=file_hz)


def test_a_run_with_a_gap_is_not_accepted_as_a_history(tmp_path):
    """Joined scans would play too fast by the missing time, and one scan would have no duration."""
    rig = Rig(from_flat(RigConfig(), {"daq.rate_hz": 2_000, "daq.block_scans": 20}))
    scans = [("daq/scan", block.scan) for block in rig.advance(2_000_000_000)]
    whole = [("daq/info", rig.info()), *scans]
    record(tmp_path / "whole", whole)
    assert len(history(tmp_path / "whole", 2_000, "A")) == 4_000
    assert len(history(tmp_path / "whole", 2_000, "m/s²", "accelerometer")) == 4_000
    for channel, wanted in (("laser", "A"), ("accelerometer", "m"), ("current", "m/s²")):
        with pytest.raises(ConfigError, match=f"cannot be converted to {wanted}, which is .* channel with --signal$"):
            history(tmp_path / "whole", 2_000, wanted, channel)
    with pytest.raises(ConfigError, match=r"no channel 'time'; choose one by --signal NAME: accelerometer, laser"):
        history(tmp_path / "whole", 2_000, "A", "time")
    with pytest.raises(ConfigError, match="a run states the units and the rate of its channels: omit --unit"):
        history(tmp_path / "whole", 2_000, "A", unit="mA")
    with pytest.raises(ConfigError, match="omit --file-rate"):
        history(tmp_path / "whole", 2_000, "A", file_hz=100.0)
    record(tmp_path / "holed", whole[:50] + whole[51:])
    with pytest.raises(RecordingError, match="missing or out of order, but a signal to play must have no gap"):
        history(tmp_path / "holed", 2_000, "A")
    record(tmp_path / "restarted", [whole[0], *scans[50:], *scans[:1]])
    with pytest.raises(RecordingError, match="missing or out of order"):
        history(tmp_path / "restarted", 2_000, "A")
    one = [("daq/scan", Table(table.stamp_ns, table.rows[:1])) for _, table in scans[:1]]
    record(tmp_path / "one", [*whole[:1], *one])
    with pytest.raises(RecordingError, match="the run has only one scan"):
        history(tmp_path / "one", 2_000, "A")
