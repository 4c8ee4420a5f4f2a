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
"""One validator for every kind of input: what it accepts, what it rejects, and its messages."""

from __future__ import annotations

import functools
import math

import attrs
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from impact_rig.errors import ConfigError
from impact_rig.physics.contact import LAWS
from impact_rig.rig import config
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.system import files

FIELDS = {name: (about, default) for name, about, default in config.fields()}
NUMBERS = [name for name, (_, default) in FIELDS.items() if type(default) is float]
INTEGERS = [name for name, (_, default) in FIELDS.items() if type(default) is int]
WORDS = [name for name, (about, _) in FIELDS.items() if about.choices]
SWITCHES = [name for name, (_, default) in FIELDS.items() if type(default) is bool]

anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.binary(max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)


def write(tmp_path, text):
    path = tmp_path / "mine.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_every_value_has_a_description():
    for name, (about, _) in FIELDS.items():
        assert about.doc.endswith("."), name
        assert about.unit, name
        assert ";" not in about.unit, name


def test_the_name_of_a_field_contains_its_unit():
    """The unit in the name `gap_m` excludes that it is taken for millimetres."""
    endings = {"m": "_m", "Hz": "_hz", "kg": "_kg", "Pa": "_pa", "N/m": "_n_m", "ppm": "_ppm", "ohm": "_ohm"}
    for name, (about, _) in FIELDS.items():
        assert name.removesuffix("_rms").endswith(endings.get(about.unit, "")), f"{name} [{about.unit}]"


def test_flattening_a_configuration_is_reversible():
    assert config.from_flat(RigConfig(), config.to_flat(RigConfig())) == RigConfig()


@pytest.mark.heavy
@given(gap=st.floats(1e-4, 0.05), law=st.sampled_from(tuple(LAWS)), peers=st.lists(st.sampled_from("abc")))
def test_a_dumped_configuration_loads_unchanged(gap, law, peers, tmp_path_factory):
    changed = config.from_flat(RigConfig(), {"barriers.gap_m": gap, "contact.law": law, "time.peers": peers})
    path = tmp_path_factory.mktemp("dump") / "mine.yaml"
    path.write_text(config.dump(changed), encoding="utf-8")
    assert config.load_config(path) == changed


def test_a_file_can_omit_the_outer_keys_and_most_values(tmp_path):
    bare = config.load_config(write(tmp_path, "barriers: {gap_m: 0.004}\n"))
    wrapped = config.load_config(write(tmp_path, "/**:\n  ros__parameters:\n    barriers:\n      gap_m: 0.004\n"))
    assert bare == wrapped == config.from_flat(RigConfig(), {"barriers.gap_m": 0.004})
    assert config.load_config(write(tmp_path, "")) == RigConfig()


def test_overrides_take_precedence_over_the_file(tmp_path):
    path = write(tmp_path, "barriers: {gap_m: 0.004}\n")
    assert config.load_config(path, {"barriers.gap_m": 0.008}).barriers.gap_m == 0.008


def test_an_integer_is_accepted_for_a_float():
    changed = config.from_flat(RigConfig(), {"shaker.ramp_s": 1})
    assert changed.shaker.ramp_s == 1.0
    assert type(changed.shaker.ramp_s) is float


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "1.0", True, None, [1.0], 10**400])
def test_number_fields_accept_only_finite_numbers(name, value):
    with pytest.raises(ConfigError, match=name.split(".")[-1]):
        config.from_flat(RigConfig(), {name: value})


@pytest.mark.parametrize("name", INTEGERS)
@pytest.mark.parametrize("value", [1.5, math.nan, "1", True, None, 2**100])
def test_integer_fields_accept_only_integers(name, value):
    with pytest.raises(ConfigError, match=f"{name.split('.')[-1]} must be"):
        config.from_flat(RigConfig(), {name: value})


@pytest.mark.parametrize("name", WORDS)
def test_a_text_value_must_be_one_of_the_choices(name):
    about, _ = FIELDS[name]
    with pytest.raises(ConfigError, match=f"must be one of {', '.join(about.choices)}, got 'nonsense'"):
        config.from_flat(RigConfig(), {name: "nonsense"})


@pytest.mark.parametrize("name", SWITCHES)
@pytest.mark.parametrize("value", [0, 1, "true", None])
def test_a_switch_is_true_or_false(name, value):
    with pytest.raises(ConfigError, match="must be true or false"):
        config.from_flat(RigConfig(), {name: value})


@pytest.mark.parametrize("name", NUMBERS + INTEGERS)
def test_limits_apply_on_both_sides(name):
    about, default = FIELDS[name]
    kind = type(default)
    for limit, is_open, outside in ((about.low, about.low_open, -math.inf), (about.high, about.high_open, math.inf)):
        if limit is None:
            continue
        beyond = int(limit) + (1 if outside > 0 else -1) if kind is int else math.nextafter(limit, outside)
        with pytest.raises(ConfigError, match="must be"):
            config.from_flat(RigConfig(), {name: kind(beyond)})
        if is_open:
            with pytest.raises(ConfigError, match="must be"):
                config.from_flat(RigConfig(), {name: kind(limit)})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"barriers.gap_m": -0.002}, "barriers.gap_m must be >= 1e-06 and <= 1, got -0.002 m"),
        ({"barriers.gap_m": 6}, "barriers.gap_m must be >= 1e-06 and <= 1, got 6.0 m"),  # millimetres by mistake
        ({"barriers.gap_m": 0}, "barriers.gap_m must be >= 1e-06 and <= 1, got 0.0 m"),  # no sphere is sphere.present
        ({"barrier.gap_m": 0.002}, "unknown key 'barrier.gap_m', did you mean 'barriers.gap_m'?"),
        ({"barriers": {"gap_m": 0.002}}, "unknown key 'barriers'"),
        ({"barriers.gap_m.x": 1}, "unknown key 'barriers.gap_m.x'"),
        ({"contact.law": "Flores"}, "contact.law must be one of exact, flores"),
        ({"time.peers": ["analysis", 3]}, "time.peers must be a list of texts"),
        ({"time.peers": "analysis"}, "time.peers must be a list of texts"),
        ({"shaker.frequency_min_hz": 300.0}, "shaker.frequency_min_hz must be < frequency_max_hz = 200 Hz, got 300"),
        ({"drive.random_low_hz": 20.0}, "drive.random_low_hz must be < random_high_hz = 20 Hz, got 20"),
        ({"drive.frequency_hz": 4.0}, "drive.frequency_hz must be within the shaker's 5 to 200 Hz, got 4"),
    ],
)
def test_a_rejection_names_key_value_and_range(changes, message):
    with pytest.raises(ConfigError) as refused:
        config.from_flat(RigConfig(), changes)
    assert message in str(refused.value)


def test_changes_are_validated_together():
    """Both new limits are above the old upper one, so one at a time would be rejected in either order."""
    changes = {"shaker.frequency_min_hz": 300.0, "shaker.frequency_max_hz": 400.0, "drive.frequency_hz": 350.0}
    assert config.from_flat(RigConfig(), changes).drive.frequency_hz == 350.0


def test_one_invalid_change_rejects_all_changes():
    base = RigConfig()
    with pytest.raises(ConfigError):
        config.from_flat(base, {"barriers.gap_m": 0.004, "contact.restitution": 7.0})
    assert base == RigConfig()


def test_sections_are_immutable():
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        RigConfig().barriers.gap_m = 1.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("barriers: {gap_m: 6}", "barriers.gap_m must be >= 1e-06 and <= 1, got 6.0 m (PATH)"),
        ("barriers: {gap: 6}", "unknown key 'barriers.gap', did you mean 'barriers.gap_m'? (PATH)"),
        ("barriers: {gap_m: }", "barriers.gap_m must be a number in m, got nothing (PATH)"),
        ("barriers: 3", "unknown key 'barriers'"),
        ("barriers: {}", "unknown key 'barriers'"),
        ("- 1", "a configuration must be a mapping of sections, got a list (PATH)"),
        ("17", "a configuration must be a mapping of sections, got a single value (PATH)"),
        ("1: {gap_m: 6}", "a key must be a text, got 1 (PATH)"),
        ("a: [", "cannot be read as plain YAML"),
        ("a: 2024-13-99", "cannot be read as plain YAML: month must be in 1..12 (PATH)"),
        ("a: !!python/object/apply:os.system ['true']", "cannot be read as plain YAML"),
        (b"\xff\xfe\x00", "cannot be read as plain YAML: it must be UTF-8 text"),
        ("? [a, b]\n: 1", "cannot be read as plain YAML"),
        ("[" * 3000, "cannot be read as plain YAML"),
        ("barriers: " * 50, "cannot be read as plain YAML"),
        ("#" * 1_000_001, "larger than 1000000 bytes"),
    ],
    ids=lambda value: repr(value)[:30],
)
def test_a_malformed_file_is_rejected_with_its_name(tmp_path, text, message):
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as refused:
        config.load_config(path)
    assert message.replace("PATH", str(path)) in str(refused.value)
    assert str(path) in str(refused.value)


def test_a_missing_file_is_rejected_with_its_name(tmp_path):
    with pytest.raises(ConfigError, match=r"cannot read configuration: No such file.*nowhere\.yaml"):
        config.load_config(tmp_path / "nowhere.yaml")
    with pytest.raises(ConfigError, match="cannot read configuration: Is a directory"):
        config.load_config(tmp_path)


def test_the_error_of_a_missing_file_names_the_installed_one(tmp_path, monkeypatch):
    """The pages call it `config/nominal.yaml`, which is not in the working directory of an installed package."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"\(config/nominal\.yaml\); the package has (.+)") as refused:
        config.load_config("config/nominal.yaml")
    assert config.load_config(str(refused.value).partition("the package has ")[2]) == config.RigConfig()


def test_a_missing_file_is_named_even_if_the_package_has_lost_its_configurations(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "share_dir", functools.partial(files.share_dir, tmp_path / "impact_rig"))
    with pytest.raises(ConfigError, match=r"No such file or directory \(mine\.yaml\)$"):
        config.load_config("mine.yaml")


@pytest.mark.parametrize(
    ("name", "given", "taken"),
    [
        ("time.publish_clock", True, "always"),
        ("time.publish_clock", "off", "never"),
        ("instruments.adc.anti_alias", False, "none"),
        ("instruments.adc.anti_alias", "off", "none"),
        ("instruments.laser.noise_m_rms", "6e-05", 6e-05),
        ("structure.mass_kg", "1.5E-1", 0.15),
    ],
)
def test_values_that_yaml_misreads_are_read_as_intended(name, given, taken):
    assert config.to_flat(config.from_flat(RigConfig(), {name: given}))[name] == taken


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("instruments.adc.anti_alias", True),
        ("time.publish_clock", 1),
        ("structure.mass_kg", "1.5"),
        ("structure.mass_kg", "1e999"),
        ("drive.kind", "on"),
    ],
)
def test_meaningless_values_are_rejected(name, given):
    with pytest.raises(ConfigError, match=name):
        config.from_flat(RigConfig(), {name: given})


@pytest.mark.parametrize("name", sorted(FIELDS))
def test_choices_of_a_field_are_strings_in_yaml(name):
    """`ros2 param load` parses the text of a value once more: `on` would become a boolean."""
    for word in FIELDS[name][0].choices:
        assert yaml.safe_load(word) == word


@pytest.mark.heavy
@given(st.sampled_from(sorted(FIELDS)), anything)
def test_no_invalid_value_passes_the_validator(name, value):
    """An accepted value has the field's type, is finite and in range; every other one is rejected with a message."""
    try:
        changed = config.from_flat(RigConfig(), {name: value})
    except ConfigError as error:
        assert name.split(".")[-1] in str(error)  # noqa: PT017  # either outcome is right, each with its condition
        return
    about, default = FIELDS[name]
    taken = config.to_flat(changed)[name]
    assert type(taken) is type(default)
    if isinstance(taken, float | int):
        assert math.isfinite(taken)
        assert about.low is None or taken >= about.low
        assert about.high is None or taken <= about.high


@given(content=st.binary(max_size=200) | st.text(max_size=200).map(str.encode))
def test_no_file_crashes_the_loader(content, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "fuzz.yaml"
    path.write_bytes(content)
    try:
        config.load_config(path)
    except ConfigError as error:
        assert str(path) in str(error)  # noqa: PT017  # either outcome is right


@pytest.mark.parametrize(("formerly", "now"), [("freewheel", "free_running"), ("stepped", "lockstep")])
def test_time_modes_of_the_previous_version_are_read(formerly: str, now: str) -> None:
    """Recordings contain the old names in their configurations."""
    assert from_flat(RigConfig(), {"time.peers": ["analysis"], "time.mode": formerly}).time.mode == now
    with pytest.raises(ConfigError, match="one of realtime, free_running, lockstep, got 'flying'"):
        from_flat(RigConfig(), {"time.mode": "flying"})
