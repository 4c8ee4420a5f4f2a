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
"""`Campaign`: a validated campaign file, and its jobs.

A campaign is one YAML file with studies. A study measures all combinations of the values of its axes (frequency, gap,
current and others). A wrong file is rejected before anything runs; the message names key, value, range and file.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import attrs

from impact_rig.analysis.settings import TrackerSettings
from impact_rig.config.tree import Value, flatten
from impact_rig.errors import ConfigError
from impact_rig.physics.contact import LAWS
from impact_rig.rig.config import RigConfig, differences, from_flat
from impact_rig.rig.gaps import NO_SPHERE, gap_values
from impact_rig.system import budget
from impact_rig_studies.campaign import axes
from impact_rig_studies.campaign.job import Job
from impact_rig_studies.campaign.paper import CURRENT_A
from impact_rig_studies.campaign.tasks import load_plan
from impact_rig_studies.operate.plans import Direction

RESET = "reset"  # direction of a study whose points each start with a reset rig
DIRECTIONS = (RESET, *(direction.value for direction in Direction))
STARTS = ("left", "centre", "right")
GAP_VALUES = ("barriers.gap_m", "sphere.present")  # configuration values that a gap of `gaps_m` determines
OWNED = ("daq.block_scans", "time.", "step.", "pluck.", "output.autostart", "output.truth_scan")
"""Beginnings of the names of configuration values that the campaign itself sets, so a campaign file must not."""
NAMED_AXES: Mapping[str, tuple[str, Callable[[str, object], tuple[Value, ...]]]] = {
    "laws": ("contact.law", lambda key, given: axes.words(key, given, LAWS)),
    "restitutions": ("contact.restitution", lambda key, given: axes.numbers(key, given, 0.0, 1.0)),
    "starts": ("sphere.start", lambda key, given: axes.words(key, given, STARTS)),
    "seeds": ("daq.seed", lambda key, given: tuple(axes.whole(key, one, 0, 2**53) for one in axes.values(key, given))),
}
"""Key of a study -> dotted name of the configuration value that it varies, and the reader of the key's values."""
OTHERWISE = {**{name: key for key, (name, _) in NAMED_AXES.items()}, **dict.fromkeys(GAP_VALUES, "gaps_m")}
"""Dotted name of a configuration value -> key of a study that varies it; it must not be in `vary`."""


@attrs.frozen(kw_only=True)
class Study:
    """Study of a campaign file, which measures all combinations of its frequencies, gaps, currents and other values."""

    name: str
    frequencies_hz: tuple[float, ...]
    gaps_m: tuple[float, ...]  # `NO_SPHERE` means without the sphere
    currents_a: tuple[float, ...] = (CURRENT_A,)
    direction: str = RESET  # `reset`: the rig is reset before each frequency; else the order of one sweep without reset
    repetitions: int = 1  # number of measurements per frequency
    traces: bool = False  # whether to keep scans and true motion at the end of each job
    vary: Mapping[str, tuple[Value, ...]] = attrs.field(factory=dict)
    """Values of the study's other axes, by dotted name of the varied configuration value."""

    @property
    def points(self) -> int:
        """Number of points to measure: combinations of values times repetitions, twice as many for `up_down`."""
        axes = (self.frequencies_hz, self.gaps_m, self.currents_a, *self.vary.values())
        return (1 + (self.direction == Direction.UP_DOWN)) * self.repetitions * math.prod(map(len, axes))


@attrs.frozen(eq=False, kw_only=True)
class Planned:
    """Job of a campaign, with the name of its study and its values of the study's axes."""

    study: str
    job: Job
    axes: Mapping[str, Value]  # its values of axes other than frequency, gap and current, by dotted name
    reference: bool  # whether it has rig and current of the reference job, for which the paper's statements are judged


@attrs.frozen(eq=False, kw_only=True)
class Campaign:
    """Content of a validated campaign file: the rig, the settings of the analysis, and the studies."""

    title: str
    base: RigConfig  # rig that all studies start with
    analysis: Mapping[str, Value]  # settings of the analysis that the file states
    studies: tuple[Study, ...]
    text: str  # content of the file
    first: Study | None = None  # study whose first combination is the reference rig; None means the first of `studies`

    def reference(self) -> Job:
        """Return the reference job: the first job of the campaign file, even if `only` has left out its study.

        The paper's statements are judged from jobs with the rig and current of the reference job, at any gap.

        Raises:
            ConfigError: the values of the job are inconsistent; the message names the study.
        """
        return next(self._expand(self.first or self.studies[0])).job

    def planned(self) -> list[Planned]:
        """Return the jobs of all studies in the order of the file.

        A job that two studies contain occurs twice, with the same key.

        Raises:
            ConfigError: a combination of values is inconsistent; the message names the study.
        """
        found = [planned for study in self.studies for planned in self._expand(study)]
        first = self.reference()
        rig = _without_gap(first.changes)
        return [
            attrs.evolve(
                planned, reference=_without_gap(planned.job.changes) == rig and planned.job.current_a == first.current_a
            )
            for planned in found
        ]

    def only(self, names: tuple[str, ...]) -> Campaign:
        """Return the campaign restricted to these studies, in the order of its file; `reference` stays the same.

        Raises:
            ConfigError: there is no study of one of these names; the message lists the known ones.
        """
        known = [study.name for study in self.studies]
        for name in names:
            axes.word("study", name, known)
        chosen = tuple(study for study in self.studies if study.name in names)
        return attrs.evolve(self, studies=chosen, first=self.first or self.studies[0])

    def _expand(self, study: Study) -> Iterator[Planned]:
        combinations = itertools.product(itertools.product(*study.vary.values()), study.currents_a, study.gaps_m)
        for values, current, gap in combinations:
            varied = dict(zip(study.vary, values, strict=True))
            try:
                config = from_flat(self.base, {**varied, **gap_values(gap)})
            except ConfigError as error:
                raise ConfigError(f"study {study.name}: {error}") from error
            changes = differences(config)
            points = [study.frequencies_hz]
            if study.direction == RESET:
                points = [(frequency,) for frequency in study.frequencies_hz]
            for frequencies in points:
                job = Job(
                    changes=changes,
                    analysis=self.analysis,
                    gap_m=gap,
                    frequencies_hz=frequencies,
                    direction=Direction.UP if study.direction == RESET else Direction(study.direction),
                    current_a=current,
                    repetitions=study.repetitions,
                    traces=study.traces,
                )
                yield Planned(study=study.name, job=job, axes=varied, reference=False)


def load_campaign(
    path: str | Path, overrides: Mapping[str, object] | None = None, resolved: RigConfig | None = None
) -> Campaign:
    """Read a campaign from a YAML file, and check all combinations of its values.

    Args:
        path: path of the file.
        overrides: configuration values that override the file, by dotted name.
        resolved: rig that all studies start with. If it is given, `overrides` and the keys `config` and `set` of the
            file are ignored.

    Raises:
        ConfigError: the file cannot be read or is wrong; the message names key, value, range and file.
        BudgetError: the campaign has more than `budget.POINTS` points (`Study.points` of all studies).
    """
    file = Path(path)

    def read(document: object, text: str) -> Campaign:
        top = axes.mapping("a campaign", document)
        base = resolved or from_flat(axes.rig(top, file.parent, _refuse_owned), overrides or {})
        campaign = _read(top, base, text, file.stem)
        budget.allow("points in a campaign", sum(study.points for study in campaign.studies), budget.POINTS)
        campaign.planned()
        return campaign

    return load_plan(file, "campaign", read)


def _read(top: Mapping[str, object], base: RigConfig, text: str, name: str) -> Campaign:
    axes.check_keys("", top, ("title", "config", "set", "analysis", "studies"))
    studies = axes.mapping("studies", top.get("studies"))
    if not studies:
        raise axes.wrong("studies", "a mapping of one or more studies", top.get("studies"))
    settings = axes.settings("analysis", top.get("analysis"), TrackerSettings)
    return Campaign(
        title=str(top.get("title", name)),
        base=base,
        analysis={name: getattr(settings, name) for name in axes.mapping("analysis", top.get("analysis"))},
        studies=tuple(_study(name, content, base) for name, content in studies.items()),
        text=text,
    )


def _study(name: str, content: object, base: RigConfig) -> Study:
    where = f"studies.{name}"
    given = axes.mapping(where, content)
    known = ("frequencies_hz", "gaps_m", "currents_a", *NAMED_AXES, "vary", "direction", "repetitions", "traces")
    axes.check_keys(where, given, known)
    if "frequencies_hz" not in given:
        raise ConfigError(f"{where}.frequencies_hz is missing: add the drive frequencies in Hz")
    shaker = base.shaker
    frequencies = axes.numbers(f"{where}.frequencies_hz", given["frequencies_hz"], 0.0)
    for frequency in frequencies:
        if not shaker.frequency_min_hz <= frequency <= shaker.frequency_max_hz:
            rule = f">= {shaker.frequency_min_hz:g} and <= {shaker.frequency_max_hz:g} Hz"
            raise axes.wrong(f"{where}.frequencies_hz", rule, frequency)
    traces = given.get("traces", False)
    if not isinstance(traces, bool):
        raise axes.wrong(f"{where}.traces", "true or false", traces)
    own_gap = base.barriers.gap_m if base.sphere.present else NO_SPHERE
    return Study(
        name=name,
        frequencies_hz=frequencies,
        gaps_m=axes.gaps(f"{where}.gaps_m", given["gaps_m"]) if "gaps_m" in given else (own_gap,),
        currents_a=axes.numbers(f"{where}.currents_a", given.get("currents_a", CURRENT_A), 0.0),
        direction=axes.word(f"{where}.direction", given.get("direction", RESET), DIRECTIONS),
        repetitions=axes.whole(f"{where}.repetitions", given.get("repetitions", 1), 1, 1000),
        traces=traces,
        vary=_vary(where, given),
    )


def _vary(where: str, given: Mapping[str, object]) -> dict[str, tuple[Value, ...]]:
    vary = {name: read(f"{where}.{key}", given[key]) for key, (name, read) in NAMED_AXES.items() if key in given}
    for name, values in flatten(axes.mapping(f"{where}.vary", given.get("vary"))).items():
        key = f"{where}.vary.{name}"
        if name in OTHERWISE:
            raise ConfigError(f"{key} must not be in `vary`, use {where}.{OTHERWISE[name]} instead")
        _refuse_owned(key, name)
        vary[name] = axes.scalars(key, values)
    return vary


def _refuse_owned(key: str, name: str) -> None:
    if name.startswith(OWNED):
        raise ConfigError(f"{key} is set by the campaign itself, remove it")


def _without_gap(changes: Mapping[str, Value]) -> dict[str, Value]:
    return {name: value for name, value in changes.items() if name not in GAP_VALUES}
