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
"""A campaign file becomes jobs, or it is rejected with key, value, range and file."""

from __future__ import annotations

import pytest

from impact_rig.errors import ConfigError
from impact_rig.system.files import config_dir
from impact_rig_studies.campaign.plan import load_campaign
from impact_rig_studies.operate.plans import Direction


@pytest.fixture
def write(tmp_path):
    def write(text):
        path = tmp_path / "c.yaml"
        path.write_text(text)
        return path

    return write


def study(**given):
    lines = "".join(f"    {name}: {value}\n" for name, value in given.items())
    return f"studies:\n  s:\n{lines}"


def test_a_study_is_the_product_of_its_axes(write):
    text = study(
        frequencies_hz="[9.0, 9.1]", gaps_m="[none, 0.002]", laws="[flores, exact]", seeds="[1, 2]",
        currents_a="[0.3, 0.5]", vary="{sphere.density_kg_m3: [7850, 2700]}",
    )  # fmt: skip
    planned = load_campaign(write(text)).planned()
    assert len(planned) == len({one.job.key for one in planned}) == 2**6
    one = next(p for p in planned if p.axes == {"contact.law": "exact", "daq.seed": 2, "sphere.density_kg_m3": 2700})
    config = one.job.config()
    assert (config.contact.law, config.daq.seed, config.sphere.density_kg_m3) == ("exact", 2, 2700.0)
    assert (config.sphere.present, one.job.gap_m) == (False, 0.0)


def test_a_range_includes_its_end_and_has_round_values(write):
    campaign = load_campaign(write(study(frequencies_hz="{from: 9.00, to: 9.12, step: 0.01}")))
    assert campaign.studies[0].frequencies_hz == tuple(round(9 + i / 100, 2) for i in range(13))


def test_single_points_begin_with_a_reset_and_sweeps_are_one_job(write):
    points = load_campaign(write(study(frequencies_hz="[9.0, 9.1, 9.2]"))).planned()
    assert [one.job.frequencies_hz for one in points] == [(9.0,), (9.1,), (9.2,)]
    (sweep,) = load_campaign(write(study(frequencies_hz="[9.0, 9.1, 9.2]", direction="down"))).planned()
    assert sweep.job.plan().points() == (9.2, 9.1, 9.0)
    assert sweep.job.direction is Direction.DOWN


def test_the_key_of_a_job_depends_only_on_what_affects_its_numbers(write):
    def key(text, **overrides):
        return load_campaign(write(text), overrides).planned()[0].job.key

    plain = study(frequencies_hz="9.1")
    assert key(plain) == key(study(frequencies_hz="9.1", traces="true"))
    assert key(plain) == key(f"title: another\n{plain}")
    others = [
        key(study(frequencies_hz="9.2")), key(study(frequencies_hz="9.1", repetitions="2")),
        key(plain, **{"daq.seed": 2}), key(f"analysis: {{window_s: 0.5}}\n{plain}"),
        key(f"set: {{structure.mass_kg: 0.14}}\n{plain}"),
        key(study(frequencies_hz="9.1", gaps_m="none")), key(study(frequencies_hz="9.1", currents_a="0.4")),
    ]  # fmt: skip
    assert len({key(plain), *others}) == 8


def test_the_reference_is_the_first_rig_of_the_first_study(write):
    text = "studies:\n  a: {frequencies_hz: 9.1, gaps_m: [none, 0.002], laws: [exact, flores]}\n"
    text += "  b: {frequencies_hz: 9.2, gaps_m: 0.004}\n  c: {frequencies_hz: 9.2, laws: exact, gaps_m: 0.004}\n"
    planned = load_campaign(write(text)).planned()
    assert [one.reference for one in planned] == [True, True, False, False, False, True]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("studies: {}", "studies must be a mapping of one or more studies"),
        ("studys: {}", "unknown key 'studys', known: title"),
        (study(frequencies_hz="9.1", gap="0.1"), "unknown key 'gap' in studies.s, known: frequencies_hz, gaps_m"),
        (study(gaps_m="0.002"), "studies.s.frequencies_hz is missing"),
        (study(frequencies_hz="[]"), "studies.s.frequencies_hz must be a list of 1 to"),
        (study(frequencies_hz="[9.1, fast]"), "studies.s.frequencies_hz[1] must be a number, got 'fast'"),
        (study(frequencies_hz="[9.1, 500]"), "studies.s.frequencies_hz must be >= 5 and <= 200 Hz, got 500"),
        (study(frequencies_hz="[1, true]"), "studies.s.frequencies_hz[1] must be a number, got true"),
        (study(frequencies_hz="[9.1, 9.1]"), "must not repeat a value, got 9.1 twice"),
        (study(frequencies_hz="9.1", gaps_m="[none, null]"), "must not repeat a value, got 'none' and null"),
        (study(frequencies_hz="{from: 9, to: 8, step: 1}"), "frequencies_hz.to must be >= from = 9, got 8"),
        (study(frequencies_hz="{from: 9, to: 10}"), "must have from, to and step; missing: step"),
        (study(frequencies_hz="9.1", gaps_m="[0.0]"), "studies.s.gaps_m[0] must be > 0 and <= 1, got 0.0"),
        (study(frequencies_hz="9.1", laws="[newton]"), "studies.s.laws must be one of exact, flores,"),
        (study(frequencies_hz="9.1", restitutions="1.2"), "studies.s.restitutions[0] must be > 0 and <= 1, got 1.2"),
        (study(frequencies_hz="9.1", seeds="-1"), "studies.s.seeds must be an integer >= 0"),
        (study(frequencies_hz="9.1", direction="sideways"), "direction must be one of reset, up, down, up_down"),
        (study(frequencies_hz="9.1", repetitions="0"), "repetitions must be an integer >= 1 and <= 1000, got 0"),
        (study(frequencies_hz="9.1", vary="{contact.law: exact}"), "use studies.s.laws"),
        (study(frequencies_hz="9.1", vary="{sphere.weight: 1}"), "study s: unknown key 'sphere.weight'"),
        (study(frequencies_hz="9.1", vary="{sphere.density_kg_m3: -1}"), "density_kg_m3 must be >"),
        ("set: {daq.block_scans: 5}", "set.daq.block_scans is set by the campaign"),
        ("analysis: {window_s: 0}\nstudies: {s: {frequencies_hz: 9.1}}", "analysis.window_s must be > 0 and <= 100"),
        ("studies: [", "cannot be read as plain YAML"),
    ],
)  # fmt: skip
def test_an_invalid_file_is_rejected_with_key_value_range_and_file_name(write, text, words):
    with pytest.raises(ConfigError) as caught:
        load_campaign(write(text))
    assert words in str(caught.value)
    assert str(caught.value).endswith("c.yaml)")


def test_the_points_of_a_study_are_those_of_its_jobs(write):
    for direction in ("reset", "up", "up_down"):
        text = study(frequencies_hz="[9.0, 9.1]", gaps_m="[0.002, 0.004]", direction=direction, repetitions="3")
        campaign = load_campaign(write(text))
        jobs = [one.job for one in campaign.planned()]
        assert campaign.studies[0].points == sum(job.repetitions * len(job.plan().points()) for job in jobs), direction


def test_a_campaign_can_name_its_rig_and_change_it(write, tmp_path):
    (tmp_path / "rig.yaml").write_text("structure: {mass_kg: 0.2}\n")
    text = f"config: rig.yaml\nset: {{daq.rate_hz: 20000}}\n{study(frequencies_hz='9.1')}"
    config = load_campaign(write(text), {"daq.seed": 7}).planned()[0].job.config()
    assert (config.structure.mass_kg, config.daq.rate_hz, config.daq.seed) == (0.2, 20_000, 7)
    with pytest.raises(ConfigError, match=r"nowhere\.yaml"):
        load_campaign(write(f"config: nowhere.yaml\n{study(frequencies_hz='9.1')}"))


def test_the_campaign_of_the_paper_has_six_cases_at_ten_frequencies():
    campaign = load_campaign(config_dir() / "paper.yaml").only(("curves",))
    assert len(campaign.planned()) == 60
    assert all(one.reference for one in campaign.planned())
    with pytest.raises(ConfigError, match="study must be one of curves"):
        campaign.only(("nothing",))


@pytest.mark.heavy
@pytest.mark.parametrize("name", ["restitution", "mass", "amplitude"])
def test_a_study_run_alone_keeps_the_reference_rig_of_its_campaign(name):
    """The first study run alone must not define another reference rig, such as one of light spheres."""
    campaign = load_campaign(config_dir() / "campaigns" / "beyond.yaml")
    whole = {one.job.key: one.reference for one in campaign.planned()}
    alone = campaign.only((name,)).planned()
    assert [one.reference for one in alone] == [whole[one.job.key] for one in alone]
