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
"""Known-input check: readings of a calibration sine in every channel, compared with the calibration certificate.

The sine is fed into a copy of the instruments with the rig's configuration, its seed (and so its calibration errors)
and given faults; the rig itself is not disturbed. To see the sine in the rig's own scans, use `Chain.calibrate`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.interpolation import NODES
from impact_rig.errors import CommandError
from impact_rig.instruments.chain import Chain, sensors
from impact_rig.instruments.fault import Fault
from impact_rig.instruments.instrument import BOARD_KINDS
from impact_rig.instruments.section import InstrumentSetup

_SETTLE_TICKS = 400  # 4 s, in which the 1 Hz high-pass decays to e^-25
_MEASURE_TICKS = 100
_COVERAGE = 2.5
"""Factor by which a deviation may exceed its standard uncertainty. It allows any single error at its tolerance, but not
several at their limits: a rectangular error reaches √3 standard uncertainties, linearity √6.
"""


@attrs.frozen
class ChannelCheck:
    """Result of the known-input check for one channel: the measured sine compared with the certificate.

    Attributes:
        channel: name of the channel.
        expected: amplitude of the sine in the reading of a nominal instrument [unit of the channel].
        measured: amplitude of the sine fitted to the reading [unit].
        gain: `measured` over `expected`, negative if the channel is inverted.
        gain_limit: largest allowed deviation of |gain| from 1, and of `phase_rad` from 0.
        phase_rad: phase of the reading relative to the expected sine, within ± π/2 [rad]; positive if the reading
            leads, 0 without a signal. For an inverted channel, it is relative to the inverted sine.
        residual: rms of the part of the reading that is neither the sine nor a constant [unit].
        residual_limit: largest allowed residual [unit].
        polarity: 1 correct, −1 inverted, 0 no signal (less than a tenth of the expected one).
        ok: whether gain, phase and residual are within their limits and the polarity is 1.
    """

    channel: str
    expected: float
    measured: float
    gain: float
    gain_limit: float
    phase_rad: float
    residual: float
    residual_limit: float
    polarity: int
    ok: bool


class _Rest:
    """Motion of a rig at rest, as instruments read it: all quantities are zero, and there are no impacts."""

    impacts = np.zeros(
        0, dtype=[("tick", "i8"), ("offset", "f8"), ("wall", "i1"), ("impulse", "f8"), ("duration", "f8")]
    )

    def quantities(
        self,
        names: tuple[str, ...],
        tick: NDArray[np.int64],
        offset_s: NDArray[np.float64],  # noqa: ARG002 - required by the protocol
    ) -> NDArray[np.float64]:
        """Return zeros for each quantity at each instant, shape (names, instants)."""
        return np.zeros((len(names), len(tick)))

    def polynomials(
        self,
        names: tuple[str, ...],
        tick: NDArray[np.int64],
        start_s: NDArray[np.float64],  # noqa: ARG002
        end_s: NDArray[np.float64],  # noqa: ARG002
    ) -> NDArray[np.float64]:
        """Return zeros as polynomials of each quantity on each piece, shape (names, pieces, NODES)."""
        return np.zeros((len(names), len(tick), NODES))

    def breakpoints(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return empty arrays (tick, offset): a motion at rest is smooth everywhere."""
        return np.empty(0, dtype=np.int64), np.empty(0)


def check_known_input(
    config: InstrumentSetup, faults: Iterable[Fault] = (), frequency_hz: float = 10.0, fraction: float = 0.5
) -> list[ChannelCheck]:
    """Apply a sine to every channel of a copy of the rig's instruments and compare the readings with the certificate.

    Args:
        config: configuration of the rig; its planned faults do not act.
        faults: faults of the copy, which act all the time, whatever their own start and end; those of the whole board
            are ignored.
        frequency_hz: frequency of the sine, > 0 and at most `shaker.frequency_max_hz`; choose a whole number of hertz,
            because one second is measured.
        fraction: amplitude as a part of half the measuring range; a finite number > 0, above 1 it exceeds the range.

    Returns:
        One check per channel, in scan order.

    Raises:
        CommandError: the frequency or the amplitude is out of range, or the channel of a fault is not present.
    """
    if not 0.0 < fraction < math.inf:
        raise CommandError(f"fraction of a known-input check must be finite and > 0, got {fraction!r}")
    chain = Chain(config)
    chain.clear()  # the configuration's planned faults
    for fault in faults:
        if fault.kind not in BOARD_KINDS:
            chain.inject(attrs.evolve(fault, start_sample=0, samples=0))
    amplitudes = {}
    for sensor in sensors(config):
        low, high = sensor.measuring_range()
        amplitudes[sensor.name] = fraction * 0.5 * (high - low)
        chain.calibrate(sensor.name, frequency_hz, amplitudes[sensor.name], _SETTLE_TICKS + _MEASURE_TICKS)
    rows = chain.read(0)
    for tick in range(0, _SETTLE_TICKS + _MEASURE_TICKS, _MEASURE_TICKS):
        chain.acquire(_Rest(), tick, _MEASURE_TICKS)
        first = chain.next_scan
        rows = chain.read(chain.ready)
    time = (first + np.arange(len(rows))) / config.daq.rate_hz
    return [
        _judge(chain, index, time, rows[name], frequency_hz, amplitudes[name]) for index, name in enumerate(amplitudes)
    ]


def check_polarity(config: InstrumentSetup, faults: Iterable[Fault] = ()) -> dict[str, int]:
    """Return the polarity of every channel, by name: 1 correct, −1 inverted, 0 no signal.

    A channel is correct if a positive input (to the right) gives a positive reading. A channel has no signal if the
    reading has less than a tenth of the input's amplitude. `faults` act as in `check_known_input`.
    """
    return {check.channel: check.polarity for check in check_known_input(config, faults)}


def _judge(
    chain: Chain, index: int, time: NDArray[np.float64], reading: NDArray[np.float64], frequency_hz: float, peak: float
) -> ChannelCheck:
    sensor, info = sensors(chain.config)[index], chain.info()[index]
    angle = 2.0 * np.pi * frequency_hz * (time + float(info["skew"]))
    basis = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)
    fit, *_ = np.linalg.lstsq(basis, reading, rcond=None)
    residual = math.sqrt(float(np.mean((reading - basis @ fit) ** 2)))
    response = 1.0 if chain.config.instruments.ideal else complex(sensor.transfer.response(frequency_hz))
    ratio = complex(fit[0], fit[1]) / (peak * response)
    noise = float(info["noise"])
    gain_limit = _COVERAGE * float(info["sensitivity_uncertainty"]) + 5.0 * noise / (peak * math.sqrt(len(time))) + 1e-9
    bend = 0.0 if chain.config.instruments.ideal else 0.6 * (peak / sensor.half_range) ** 2 * sensor.linearity
    residual_limit = 2.0 * noise + bend + 1e-9 * peak
    polarity = int(np.sign(ratio.real)) if abs(ratio) > 0.1 else 0
    phase = math.atan2(ratio.imag * polarity, ratio.real * polarity) if polarity else 0.0
    within = abs(abs(ratio) - 1.0) <= gain_limit and abs(phase) <= gain_limit and residual <= residual_limit
    return ChannelCheck(
        channel=sensor.name,
        expected=peak * abs(response),
        measured=peak * abs(response) * abs(ratio),
        gain=abs(ratio) * (polarity or 1),
        gain_limit=gain_limit,
        phase_rad=phase,
        residual=residual,
        residual_limit=residual_limit,
        polarity=polarity,
        ok=within and polarity == 1,
    )
