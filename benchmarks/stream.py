# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""How fast a rig runs that is driven by a stream of samples, in process; in one thread, its processor time."""

from __future__ import annotations

import time

import numpy as np

from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.simtime import NS_PER_S

RATE_HZ = 10_000
SETTLE_S = 2


def run(seconds: int = 10) -> dict[str, float]:
    """Measure: a sine with noise at 10 kS/s, scans at 10 kS/s, 6 mm gap; the median second counts."""
    config = from_flat(
        RigConfig(),
        {
            "daq.rate_hz": RATE_HZ,
            "drive.waveform": "stream",
            "drive.stream_rate_hz": RATE_HZ,
            "barriers.gap_m": 6e-3,
        },
    )
    rig, random = Rig(config), np.random.default_rng(1)
    t = np.arange((SETTLE_S + seconds) * RATE_HZ + 1) / RATE_HZ
    samples = 0.45 * np.sin(2.0 * np.pi * 9.1 * t) + 0.02 * random.normal(size=len(t))
    spent, impacts = [], 0
    for second in range(SETTLE_S + seconds):
        first = second * RATE_HZ + (second > 0)
        began = time.thread_time()
        rig.feed(first, samples[first : (second + 1) * RATE_HZ + 1])
        blocks = rig.advance((second + 1) * NS_PER_S)
        spent.append(time.thread_time() - began)
        impacts += sum(len(block.impacts.rows) for block in blocks if block.impacts is not None)
    assert impacts > seconds, f"only {impacts} impacts: the sphere did not take part"
    return {"stream_x_realtime_10kSps": 1.0 / float(np.median(spent[SETTLE_S:]))}


if __name__ == "__main__":
    print(run())
