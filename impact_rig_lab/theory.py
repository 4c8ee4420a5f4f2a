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
"""Theoretical curves of DT over frequency at the present settings of the rig, which the page draws with measurements.

There are three kinds of curves: the closed form without the sphere, a prediction of motions with two symmetric impacts
per cycle, and branches computed before by `impact-rig dynamics continue`. The prediction takes some tenths of a second.
A thread of low priority computes it when gap, current, sphere, law or another relevant value has changed. It skips
outdated requests.
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple  # values of parameters and JSON

import numpy as np
from numpy.typing import NDArray

from impact_rig.errors import ConfigError
from impact_rig.rig.config import RigConfig, fields, from_flat, to_flat
from impact_rig.rig.journal import is_mechanics

GENTLE = 10  # niceness of the lab's threads: on a busy machine the pictures of the page are late, not the rig's blocks
KIND, WAVEFORM = "drive.kind", "drive.waveform"
DECIDING = (*(name for name, _, _ in fields() if is_mechanics(name)), KIND, WAVEFORM)
"""Configuration values that a prediction depends on."""
FREQUENCIES_HZ: NDArray[np.float64] = np.unique(
    np.concatenate([np.linspace(7.0, 11.0, 81), np.linspace(8.6, 9.6, 101)]).round(6)
)
"""Frequencies of the prediction: the initial range of the page's axis, denser near the resonance."""
IMPACTS_PER_CYCLE = 2  # number of impacts per cycle of the predicted motions
OTHER_MOTION = 0.05
"""Difference in impacts per cycle above which the measured motion is not the predicted one.

Impacts that the accelerometer misses occasionally make a smaller difference.
"""
HELD = {"current": (1.0, "A"), "prescribed": (1e6, "µm")}
"""Kinds of drive for which there is a prediction: constant current, or constant motion of the inferior base.

The values are the factor from the SI unit of its amplitude to the unit of the page, and that unit.
"""


def lower_priority() -> None:
    """Lower the priority of the calling thread, and of the threads it starts, in favour of rig and analysis."""
    thread = threading.get_native_id()
    os.setpriority(os.PRIO_PROCESS, thread, max(GENTLE, os.getpriority(os.PRIO_PROCESS, thread)))


def closed_form(values: Mapping[str, Any]) -> list[list[float]]:
    """Return the transmissibility DT of the rig without the sphere over frequency: the thin line in the page's curve.

    Args:
        values: parameters of the rig by name.

    Returns:
        Pairs [frequency in Hz, DT] from 5 to 14 Hz, and closely spaced near the natural frequency; none if the natural
        frequency or the damping ratio is unknown or 0.
    """
    natural, damping = values.get("structure.natural_frequency_hz"), values.get("structure.damping_ratio")
    if not natural or not damping:
        return []
    frequency = np.unique(np.concatenate([np.linspace(5.0, 14.0, 181), natural + np.linspace(-0.6, 0.6, 121)]))
    ratio = frequency / natural
    loss = 2.0j * damping * ratio
    found = np.abs((1.0 + loss) / (1.0 - ratio**2 + loss))
    return [[round(float(f), 4), round(float(v), 4)] for f, v in zip(frequency, found, strict=True)]


def predicted(values: Mapping[str, Any], amplitude: float) -> dict[str, Any]:
    """Compute DT of the motions with two symmetric impacts per cycle over frequency, as lines for the page's curve.

    Args:
        values: configuration values by name; names that are not in `DECIDING` are ignored.
        amplitude: amplitude of the drive, peak [A or m by `drive.kind`].

    Returns:
        A mapping. `lines` has a list for each line: [whether the motion is stable, [[frequency in Hz, DT], ...]].
        `words` is a text that describes the motions, or says why there are none. `impacts` is the number of impacts per
        cycle. This key is absent if there is no motion.
    """
    kind, waveform = str(values.get(KIND, "current")), values.get(WAVEFORM, "sine")
    if not values.get("sphere.present", True):
        return {"lines": [], "words": "Without a sphere, the closed form (thin line) is the theory."}
    if kind not in HELD:
        return {"lines": [], "words": f"No prediction for a drive of constant {kind}."}
    if waveform != "sine":
        return {"lines": [], "words": f"No prediction for a drive that is {waveform}, not a sine."}
    if not amplitude > 0.0:
        return {"lines": [], "words": "No prediction at rest."}
    try:
        from impact_rig_studies import prediction  # noqa: PLC0415  # half a second, which the first page need not wait for
    except ImportError:
        return {"lines": [], "words": "No prediction: impact_rig_studies is not installed."}

    try:
        rig = from_flat(RigConfig(), {name: values[name] for name in DECIDING if name in values})
        gap_m = rig.barriers.gap_m
        held = [amplitude if kind == one else None for one in HELD]
        branches = prediction.curves(rig, FREQUENCIES_HZ, gap_m, current_a=held[0], base_m=held[1])
    except ConfigError as error:  # friction, no loss, ...: the theory does not apply there
        return {"lines": [], "words": str(error)}
    lines = [line for one in branches for line in _parts(one.frequency_hz, one.dt, one.stable)]
    factor, unit = HELD[kind]
    what = f"{gap_m * 1e3:g} mm, {amplitude * factor:g} {unit}"
    if not lines:
        return {"lines": [], "words": f"Theory finds no motion with two impacts per cycle at {what}."}
    lasting = "" if any(lasts for lasts, _ in lines) else ", nowhere stable"
    words = f"Predicted for {what}, two impacts per cycle{lasting}."
    return {"lines": lines, "words": words, "impacts": IMPACTS_PER_CYCLE}


def contradiction(prediction: Mapping[str, Any], impacts_per_cycle: float) -> str:
    """Return a sentence for the page if the measured motion has other impacts per cycle than the predicted motion.

    The text is empty otherwise, or if there is no prediction. Differences up to `OTHER_MOTION` do not count.

    Args:
        prediction: result of `predicted`.
        impacts_per_cycle: measured number of impacts per cycle.
    """
    wanted = prediction.get("impacts")
    if wanted is None or not abs(impacts_per_cycle - wanted) > OTHER_MOTION:
        return ""
    return (
        f"Measured: {impacts_per_cycle:.2f} impacts per cycle. The prediction is for a motion with {wanted:g} and does "
        "not apply here."
    )


class Continued(NamedTuple):
    """Branches of periodic motions of the model over frequency, from a directory of `impact-rig dynamics continue`."""

    values: Mapping[str, Any]  # configuration values of `DECIDING` for which they were computed, without sphere.start
    amplitude: float  # peak amplitude of the drive for which they were computed; unit by `drive.kind`
    lines: list[list[Any]]  # DT over frequency, in the form of `lines` of `predicted`
    title: str  # title of the study

    def exists(self, values: Mapping[str, Any], amplitude: float) -> bool:
        """Return whether the branches were computed for the given settings of the rig.

        Args:
            values: parameters of the rig by name; missing ones count as equal.
            amplitude: peak amplitude of its drive [A, m or V by `drive.kind`].
        """
        return math.isclose(amplitude, self.amplitude, rel_tol=1e-6) and all(
            values.get(name, value) == value for name, value in self.values.items()
        )


def continued(directory: Path) -> Continued:
    """Read branches of motions over frequency from the output directory of `impact-rig dynamics continue`.

    Raises:
        ConfigError: the directory has no results from this version of the code, the branches are not over the
            frequency, or `impact_rig_studies` is not installed.
    """
    try:
        from impact_rig_studies.dynamics import figures, plan  # noqa: PLC0415  # as above
        from impact_rig_studies.maps.plan import FREQUENCY  # noqa: PLC0415
    except ImportError as error:
        raise ConfigError(
            f"{directory}: the branches of `impact-rig dynamics continue` cannot be read, because the package "
            "impact_rig_studies is not installed; reinstall impact_rig, which contains it"
        ) from error

    done = plan.open_study(directory, plan.CONTINUE)
    study = done.plan
    if study.over != FREQUENCY:
        raise ConfigError(
            f"{directory} has branches of `impact-rig dynamics continue` over {study.over}, but the page can draw only "
            f"those over {FREQUENCY}: choose another directory for --branches"
        )
    rig = to_flat(study.base)
    return Continued(
        values={name: rig[name] for name in DECIDING if name != "sphere.start"},
        amplitude=study.tasks[0].current_a,
        lines=[line for _, rows in done.found for line in _parts(*figures.along(study, rows, "dt"))],
        title=study.title,
    )


def _parts(
    frequency_hz: NDArray[np.float64], dt: NDArray[np.float64], stable: NDArray[np.bool_]
) -> Iterator[list[Any]]:
    """Yield the stable and unstable parts of a branch in turn, each as [is stable, [[frequency in Hz, DT], ...]].

    Successive parts share a point, so that the drawn line has no gap.

    Args:
        frequency_hz: frequencies along the branch, shape (n,).
        dt: transmissibility at each frequency, shape (n,).
        stable: whether the motion is stable at each frequency, shape (n,).
    """
    points = [[round(float(f), 4), round(float(value), 4)] for f, value in zip(frequency_hz, dt, strict=True)]
    turns = (np.flatnonzero(np.diff(stable)) + 1).tolist()
    for first, end in zip([0, *turns], [*turns, len(points)], strict=True):
        line = points[first : end + 1]
        if len(line) > 1:
            yield [bool(stable[first]), line]


class Theory:
    """Background computation of predictions for the page; only the newest request is computed.

    Args:
        on_prediction: function that receives each prediction, in a thread of this object.

    Attributes:
        branches: branches read by `continued`; branches computed for the requested settings are added to a prediction.
    """

    def __init__(self, on_prediction: Callable[[dict[str, Any]], None]) -> None:
        self.branches: Sequence[Continued] = ()
        self._on_prediction = on_prediction
        self._newest: tuple[dict[str, Any], float] | None = None
        self._computing = threading.Lock()
        self._closed = False

    def want(self, values: Mapping[str, Any], amplitude: float) -> None:
        """Request the prediction for some settings; a request equal to the previous one has no effect.

        Args:
            values: parameters of the rig by name.
            amplitude: peak amplitude of its drive [A or m by `drive.kind`].
        """
        wish = {name: values[name] for name in DECIDING if name in values}, amplitude
        if not self._closed and wish != self._newest:
            self._newest = wish
            threading.Thread(target=self._compute, args=(wish,), name="lab-theory", daemon=True).start()

    def close(self) -> None:
        """Drop all requests, including later ones, and wait until a running computation ends.

        The result of a running computation is dropped.
        """
        self._closed, self._newest = True, None
        with self._computing:
            pass

    def _compute(self, wish: tuple[dict[str, Any], float]) -> None:
        """Compute the prediction for a request, and pass it to `on_prediction`; an error is passed on as a text.

        The request `wish` consists of the rig's parameters by name, and the peak amplitude of its drive. Only one
        computation runs at a time. If a newer request arrives, this request is dropped.
        """
        lower_priority()
        with self._computing:
            if wish is not self._newest:
                return
            try:
                found = predicted(*wish)
            except Exception as error:  # values of any origin: the next request may differ
                found = {"lines": [], "words": f"No prediction: {error}"}
            for one in self.branches:
                if one.exists(*wish):
                    words = f"{found['words']} Also drawn: motions of the model ({one.title})."
                    found = {**found, "lines": [*found["lines"], *one.lines], "words": words}
            if wish is self._newest:
                self._on_prediction(found)
