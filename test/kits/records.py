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
"""Records whose truth is known in closed form, without simulator and instrument models of the package."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from scipy import signal

from impact_rig.blocks import APPLIED, DAQ_INFO, Table
from impact_rig.instruments.section import CHANNELS, SCAN
from impact_rig.simtime import stamp_ns

F_N, ZETA = 9.105, 0.0044974
BASE_M = 50e-6
PAPER_FREQUENCIES_HZ = (7.5, 8.0, 8.5, 8.9, 9.0, 9.1, 9.2, 9.5, 10.0, 10.5)
RMS = {"accelerometer": 0.049, "laser": 3e-6, "base": 1e-6, "current": 2e-3}
LAG_S = {"accelerometer": 22.5e-6, "laser": 0.7e-3, "base": 0.225e-3, "current": 8e-6}


def linear_transmissibility(frequency_hz, f_n=F_N, zeta=ZETA):
    """Return DT of a base-excited single degree of freedom, complex: (1 + 2iζr) / (1 − r² + 2iζr)."""
    r = np.asarray(frequency_hz) / f_n
    return (1 + 2j * zeta * r) / (1 - r**2 + 2j * zeta * r)


def info_rows(rate_hz=10_000, *, gain_u=1e-3, ideal=False, since_start=0.0):
    """Return a daq/info like the rig's: skewed channels and a slow laser, or ideal instruments without both."""
    rows = np.zeros(4, DAQ_INFO)
    rows["name"], rows["unit"], rows["rate"] = CHANNELS, ("m/s^2", "m", "m", "A"), rate_hz
    rows["sensitivity"], rows["range_high"] = 1.0, (1750.0, 0.01, 0.0125, 25.0)
    rows["range_low"] = -rows["range_high"]
    rows["since_start"] = since_start
    if not ideal:
        rows["sensitivity_uncertainty"] = gain_u
        rows["noise"] = [RMS[name] for name in CHANNELS]
        rows["lag"] = [LAG_S[name] for name in CHANNELS]
        rows["lag_order"] = (0, 1, 0, 1)
        rows["skew"] = np.arange(4) * min(11e-6, 0.25 / rate_hz)
    return rows


def channel_response(info, channel, frequency_hz):
    """Return the effect of lag and skew on a phasor, written independently from their definitions."""
    row = info[CHANNELS.index(channel)]
    omega = 2 * np.pi * frequency_hz
    lag = 1 / (1 + 1j * omega * row["lag"]) if row["lag_order"] == 1 else np.exp(-1j * omega * row["lag"])
    return lag * np.exp(1j * omega * row["skew"])


def steady_record(
    frequency_hz,
    seconds,
    *,
    rate_hz=10_000,
    info=None,
    base_m=BASE_M,
    current_a=0.5,
    ratio=None,
    noise=1.0,
    rng=None,
    harmonics=(),
    transient=None,
    phase=0.3,
):
    """Return the scans of a settled rig as its channels report them.

    Args:
        ratio: complex DT; None means that of the linear rig.
        noise: factor of the channels' rms noise.
        harmonics: amplitudes of the 2nd, 3rd … harmonic of x_1 after the sensor, relative to its fundamental.
        transient: complex DT as a function of time [s], instead of a constant.
    """
    info = info_rows(rate_hz) if info is None else info
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    turn = np.exp(1j * (2 * np.pi * frequency_hz * time + phase))
    ratio = linear_transmissibility(frequency_hz) if ratio is None else ratio
    x_1 = base_m * (transient(time) if transient else ratio)
    true = {"base": base_m, "laser": x_1, "current": current_a}
    true["accelerometer"] = -((2 * np.pi * frequency_hz) ** 2) * x_1
    rows = np.zeros(len(time), SCAN)
    rows["time"] = time
    for name in CHANNELS:
        rows[name] = np.real(true[name] * channel_response(info, name, frequency_hz) * turn)
        if noise:
            rows[name] += noise * RMS[name] * rng.standard_normal(len(time))
    for h, amplitude in enumerate(harmonics, start=2):
        response = channel_response(info, "laser", h * frequency_hz)
        rows["laser"] += np.real(amplitude * base_m * abs(ratio) * response * turn**h)
    return rows


def blocks(rows, rate_hz, sizes, *, start_ns=0, first=0) -> Iterator[Table]:
    """Divide scans into daq/scan tables; `sizes` is one length for all, or an iterable of lengths."""
    sizes = iter([sizes] * (len(rows) // sizes + 1) if isinstance(sizes, int) else sizes)
    at = 0
    while at < len(rows):
        part = rows[at : at + next(sizes)].copy()
        part["time"] = np.arange(len(part)) / rate_hz
        yield Table(stamp_ns(first + at, rate_hz, start_ns), part)
        at += len(part)


def applied(frequency_hz, current_a=0.5, at_ns=0, time_s=0.0) -> Table:
    rows = np.zeros(1, APPLIED)
    rows["frequency"], rows["current"], rows["time"] = frequency_hz, current_a, time_s
    return Table(at_ns, rows)


def feed_all(tracker, tables: Iterable[Table]):
    """Feed tables; return the rows of measurements and the tables of impacts."""
    found = [tracker.feed(table) for table in tables]
    return ([table for one in found for table in one.measurements], [table for one in found for table in one.impacts])


def statuses(tables):
    return [table.rows[0]["status"].decode() for table in tables]


FINE_HZ = 2_000_000
_PULSES: dict[float, np.ndarray] = {}


def contact_pulse(speed_m_s, m_1=0.13, m=1.0524e-3, e=0.31):
    """Return the acceleration by one contact as the accelerometer reports it, at FINE_HZ from first touch.

    The pulse is that of Hertz, 42.1 µs · (0.5 / v)^(1/5) long with the right impulse; resonance at 25 kHz with Q 30,
    two poles at 10 kHz.
    """
    speed = float(f"{speed_m_s:.2g}")
    if speed not in _PULSES:
        duration = 42.1e-6 * (0.5 / speed) ** 0.2
        time = np.arange(int(6e-3 * FINE_HZ)) / FINE_HZ
        force = np.maximum(np.sin(np.pi * time / duration), 0.0) ** 1.3 * (time < duration)
        force *= m * (1 + e) * speed / m_1 / (force.sum() / FINE_HZ)
        omega = 2 * np.pi * 25e3
        b, a, _ = signal.cont2discrete(([omega**2], [1.0, omega / 30.0, omega**2]), 1 / FINE_HZ, "foh")
        low_pass = signal.butter(2, 10e3, fs=FINE_HZ)
        _PULSES[speed] = signal.lfilter(*low_pass, signal.lfilter(np.ravel(b), a, force))
    return _PULSES[speed]


def add_impacts(acceleration, rate_hz, times_s, speeds_m_s, signs):
    """Add contact pulses to acceleration samples, in place."""
    for time, speed, sign in zip(times_s, speeds_m_s, signs, strict=True):
        pulse = contact_pulse(speed)
        first = int(np.ceil(time * rate_hz))
        k = np.arange(first, min(len(acceleration), first + int(len(pulse) / FINE_HZ * rate_hz) - 1))
        acceleration[k] += sign * np.interp(k / rate_hz - time, np.arange(len(pulse)) / FINE_HZ, pulse)
