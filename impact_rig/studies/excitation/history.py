# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Time histories: a response is made to follow one, by the inverse response function and iterative learning.

    drive_1 = F⁻¹ [X / H],    drive_{n+1} = drive_n + F⁻¹ [(X − Y_n) / H]

H is estimated first, at a low level, by a burst of random drive. Each trial begins and ends at rest, so that a discrete
Fourier transform over the whole trial has no ends that leak.
"""

from __future__ import annotations

from collections.abc import Callable

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy import signal

from impact_rig.operate.hardware import Hardware

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


WORSE = 1.2
"""A trial this much worse than the best ends the learning: lines on which H was estimated badly only grow."""


@attrs.frozen(kw_only=True)
class ReplicatePlan:
    """How a history is replicated.

    Attributes:
        low_hz: lower edge of the band in which the drive is corrected.
        high_hz: its upper edge.
        iterations: at the most, the first trial included.
        enough: relative error at which it is good enough.
        rest_s: at rest before and after the history [s].
        identify_rms: of the drive while the response function is estimated [A].
        identify_s: how long that takes [s], half of it at rest.
        seed: of its random numbers.
    """

    low_hz: float = attrs.field(default=2.0, validator=attrs.validators.gt(0.0))
    high_hz: float = attrs.field(default=150.0, validator=attrs.validators.gt(0.0))
    iterations: int = attrs.field(default=6, validator=attrs.validators.ge(1))
    enough: float = attrs.field(default=0.005, validator=attrs.validators.ge(0.0))
    rest_s: float = attrs.field(default=2.0, validator=attrs.validators.ge(0.0))
    identify_rms: float = attrs.field(default=1.0, validator=attrs.validators.gt(0.0))
    identify_s: float = attrs.field(default=16.0, validator=attrs.validators.gt(0.0))
    seed: int = 1


@attrs.frozen(eq=False, kw_only=True)
class Replicated:
    """A history and what followed it.

    Attributes:
        asked: shape (n,).
        reached: in the last trial, shape (n,).
        drive: of that trial, with what comes before and after, shape (m,) [A].
        rows: its scans, shape (m,).
        lead: samples before the history.
        errors: rms error over rms of what was asked, trial by trial.
    """

    asked: Real
    reached: Real
    drive: Real
    rows: NDArray[np.void]
    lead: int
    errors: tuple[float, ...]


def replicate(
    hardware: Hardware,
    asked: Real,
    plan: ReplicatePlan,
    response: Callable[[NDArray[np.void]], Real],
    progress: Callable[[int, float], None] = lambda _trial, _error: None,
) -> Replicated:
    """Make a response follow a history.

    Args:
        hardware: output and acquisition, of one rate.
        asked: the history, in the unit of the response; it begins and ends near zero; shape (n,).
        plan: how.
        response: takes from scans what is to follow, shape (n,).
        progress: called after each trial with its number from 1 and its error.

    Raises:
        CommandError: the shaker trips, or refuses the drive.
        TimeoutError: the rig did not go on.
    """
    rate_hz = hardware.wire.rate_hz
    lead = round(plan.rest_s * rate_hz)
    length = len(asked) + 2 * lead
    target = np.zeros(length)
    target[lead : lead + len(asked)] = asked
    frequency: Real = np.asarray(np.fft.rfftfreq(length, 1.0 / rate_hz), np.float64)
    inverse = _inverse(hardware, plan, response, frequency)
    drive = np.fft.irfft(inverse * np.fft.rfft(target), length)
    errors: list[float] = []
    best: Replicated | None = None
    for trial in range(1, plan.iterations + 1):
        rows = hardware.respond(drive)
        found = response(rows)
        found = found - found[: max(1, lead // 2)].mean()
        miss = target - found
        errors.append(float(np.sqrt(np.mean(miss[lead : lead + len(asked)] ** 2) / np.mean(asked**2))))
        progress(trial, errors[-1])
        if best is None or errors[-1] <= min(errors):
            best = Replicated(
                asked=asked, reached=found[lead : lead + len(asked)], drive=drive, rows=rows, lead=lead, errors=()
            )
        if errors[-1] <= plan.enough or errors[-1] > WORSE * min(errors):
            break
        drive = drive + np.fft.irfft(inverse * np.fft.rfft(miss), length)
    assert best is not None
    return attrs.evolve(best, errors=tuple(errors))


def _inverse(
    hardware: Hardware, plan: ReplicatePlan, response: Callable[[NDArray[np.void]], Real], frequency: Real
) -> Complex:
    """Return 1 / H at some frequencies, 0 outside of the band, with soft edges."""
    rate_hz = hardware.wire.rate_hz
    length = round(plan.identify_s * rate_hz)
    sections = signal.butter(2, (0.5 * plan.low_hz, 2.0 * plan.high_hz), "bandpass", fs=rate_hz, output="sos")
    burst = signal.sosfilt(sections, np.random.default_rng(plan.seed).standard_normal(length // 2))
    drive = np.zeros(length)
    drive[: len(burst)] = burst * signal.windows.tukey(len(burst), 0.1) * (plan.identify_rms / burst.std())
    found = response(hardware.respond(drive))
    x, y = np.fft.rfft(drive), np.fft.rfft(found - found[-rate_hz:].mean())
    lines = np.fft.rfftfreq(length, 1.0 / rate_hz)
    # a burst's own spectrum has holes: H is the ratio of averages over neighbouring lines
    few = signal.windows.hann(5) / signal.windows.hann(5).sum()
    h = np.convolve(y * np.conj(x), few, "same") / np.convolve(np.abs(x) ** 2, few, "same")
    at = np.interp(frequency, lines, h.real) + 1j * np.interp(frequency, lines, h.imag)
    rise = np.clip((frequency - 0.5 * plan.low_hz) / (0.5 * plan.low_hz), 0.0, 1.0)
    fall = np.clip((1.25 * plan.high_hz - frequency) / (0.25 * plan.high_hz), 0.0, 1.0)
    edge = np.sin(0.5 * np.pi * np.minimum(rise, fall)) ** 2
    inverse = np.zeros(len(frequency), np.complex128)
    inverse[edge > 0.0] = edge[edge > 0.0] / at[edge > 0.0]
    return inverse
