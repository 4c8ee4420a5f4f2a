# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What is measured of a run as a whole record, beside the live node's path: frequency response, sines, drop test."""

from __future__ import annotations

import attrs
import numpy as np

from impact_rig.analysis.drop import Drop, DropTest, parse_drop, restitution_of_drops
from impact_rig.analysis.frf import Frf, transmissibility_frf
from impact_rig.analysis.sine import SineFit, fit_sine, fit_sine_frequency
from impact_rig.analysis.transmissibility import Measurement, measure_record
from impact_rig.analysis.words import Status
from impact_rig.errors import RecordingError
from impact_rig.instruments.scan import channels_of
from impact_rig.recording import Run
from impact_rig.runs.excerpt import Excerpt, calibration_rows, last_record
from impact_rig.runs.reanalysis import remarks

COHERENT = 0.9
"""Coherence that some excited line has at least."""


def response_of(
    run: Run, segment_s: float | None = None, window: str = "hann", damping_ratio: float | None = None
) -> Frf:
    """Return the frequency response x_1 / x_b of the last record of a run, with at least one excited line.

    Args:
        run: an open run.
        segment_s: length of a segment [s]: the lines lie 1 / segment_s apart; None for what resolves the resonance.
        window: of `analysis.frf`.
        damping_ratio: of the resonance, instead of what is found.

    Raises:
        RecordingError: the record is too short, stands still, or nothing in it is excited well enough.
    """
    excerpt = last_record(run)
    segment = None if segment_s is None else round(segment_s * excerpt.rate_hz)
    try:
        found = transmissibility_frf(
            excerpt.rows, calibration_rows(run), segment, window=window, damping_ratio=damping_ratio
        )
    except ValueError as error:  # ConfigError is one
        seconds = len(excerpt.rows) / excerpt.rate_hz
        raise RecordingError(f"{run.path}: no frequency response of its last {seconds:g} s: {error}") from error
    if not np.any(np.nan_to_num(found.coherence[found.excited]) >= COHERENT):
        raise RecordingError(
            f"{run.path}: the base moves the laser's object with a coherence of {COHERENT} at no frequency: drive the "
            "rig with a chirp or noise (drive.waveform), or take longer segments"
        )
    return found


@attrs.frozen(eq=False)
class Sines:
    """An excerpt as sines of one frequency.

    Attributes:
        reference: the current with its frequency refined, four parameters and the harmonics.
        fits: every channel at that frequency, by name.
        measured: the transmissibility of the whole excerpt at the commanded frequency.
        excerpt: the scans.
    """

    reference: SineFit
    fits: dict[str, SineFit]
    measured: Measurement
    excerpt: Excerpt


def sines_of(run: Run, excerpt: Excerpt, harmonics: int = 1) -> Sines:
    """Fit sines to an excerpt of a run.

    Args:
        run: the open run.
        excerpt: of it; its drive frequency must be known.
        harmonics: in the fits, the drive included.

    Raises:
        RecordingError: no drive frequency is known, or the current holds no sine of about that frequency.
    """
    if not excerpt.drive_hz > 0.0:
        raise RecordingError(f"{run.path} holds no drive frequency (shaker/applied) for {excerpt}")
    samples = {name: np.asarray(excerpt.rows[name], dtype=np.float64) for name in channels_of(excerpt.rows)}
    reference = fit_sine_frequency(samples["current"], excerpt.rate_hz, excerpt.drive_hz, harmonics)
    if reference.status is not Status.OK:
        raise RecordingError(
            f"{run.path}: the current is no sine of {excerpt.drive_hz:g} Hz, {excerpt}: {reference.status.value}"
        )
    return Sines(
        reference=reference,
        fits={name: fit_sine(y, excerpt.rate_hz, reference.frequency_hz, harmonics) for name, y in samples.items()},
        measured=measure_record(excerpt.rows, calibration_rows(run), excerpt.drive_hz),
        excerpt=excerpt,
    )


def drops_of(run: Run, u_m: float) -> tuple[list[Drop], DropTest]:
    """Return the drops that the operator noted with a run, and the coefficient of restitution they give.

    Args:
        run: an open run.
        u_m: standard uncertainty of each height [m].

    Raises:
        RecordingError: no remark is a drop (the message says what one looks like), or they give no restitution.
    """
    drops = [drop for drop in map(parse_drop, remarks(run)) if drop is not None]
    if not drops:
        raise RecordingError(f"{run.path} holds no remark on `notes` like {Drop(0.2, 0.0245).text()!r}")
    found = restitution_of_drops(np.array([one.h0_m for one in drops]), np.array([one.h1_m for one in drops]), u_m, u_m)
    if found.status is not Status.OK:
        raise RecordingError(f"{run.path}: its {len(drops)} drops give no restitution: {found.status.value}")
    return drops, found
