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
"""Frequency responses agree with pyFRF and SciPy, recover a known system, and are refused for invalid records."""

from __future__ import annotations

import numpy as np
import pytest
from kits.records import F_N, channel_response, info_rows, linear_transmissibility
from scipy import signal

from impact_rig.analysis.frf import RESOLVED, find_resonance, frf, resolution_bias, resolving_s, transmissibility_frf
from impact_rig.instruments.section import SCAN

RATE = 1000.0


def records(noise_x=0.0, noise_y=0.0, n=60_000, seed=1):
    """Input x of noise, output y of a two-pole band-pass filter, and its exact response."""
    rng = np.random.default_rng(seed)
    clean = rng.standard_normal(n)
    b, a = signal.iirpeak(60.0, 5.0, fs=RATE)
    y = signal.lfilter(b, a, clean)
    return clean + noise_x * rng.standard_normal(n), y + noise_y * rng.standard_normal(n), (b, a)


def test_h1_h2_and_coherence_agree_with_scipy():
    x, y, _ = records(0.3, 0.1)
    found = frf(x, y, RATE, 2000)
    f, s_xy = signal.csd(x, y, RATE, nperseg=2000)
    s_xx, s_yy = (signal.welch(one, RATE, nperseg=2000)[1] for one in (x, y))
    assert np.array_equal(found.frequency_hz, f)
    assert np.allclose(found.h1, s_xy / s_xx)
    assert np.allclose(found.h2, s_yy / np.conj(s_xy))
    assert np.allclose(found.coherence, signal.coherence(x, y, RATE, nperseg=2000)[1])


@pytest.mark.parametrize("estimator", ["h1", "h2", "hv"])
def test_estimators_agree_with_pyfrf(estimator):
    """Same segments and overlap; pyFRF's Hann window is the symmetric one, which shows where there is little signal."""
    FRF = pytest.importorskip("pyFRF").FRF
    x, y, _ = records(0.3, 0.1)
    segment = 2000
    peer = FRF(
        int(RATE),
        exc=x - x.mean(),
        resp=y - y.mean(),
        exc_type="f",
        resp_type="d",
        window="hann",
        fft_len=segment,
        nperseg=segment,
        noverlap=segment // 2,
    )
    expected = {"h1": peer.get_H1, "h2": peer.get_H2, "hv": peer.get_Hv}[estimator]()[0, 0]
    found = getattr(frf(x, y, RATE, segment), estimator)
    assert np.allclose(found[5:-5], expected[5:-5], rtol=0.02)
    assert np.allclose(found[100:140], expected[100:140], rtol=5e-4)  # 50 to 70 Hz, the resonance


@pytest.mark.heavy
def test_estimates_are_ordered_h1_hv_h2_when_both_channels_are_noisy():
    """With noise on both channels, |H1| is too small, |H2| too large, and Hv with the right κ nearest to the truth."""
    x, y, (b, a) = records(0.5, 0.05, n=400_000)
    found = frf(x, y, RATE, 1000, noise_ratio=0.01)
    band = (found.frequency_hz > 50) & (found.frequency_hz < 70)
    truth = np.abs(signal.freqz(b, a, found.frequency_hz, fs=RATE)[1][band])
    h1, h2, hv = (np.abs(one[band]) for one in (found.h1, found.h2, found.hv))
    assert np.all(h1 < hv)
    assert np.all(hv < h2)
    assert np.abs(hv / truth - 1).mean() < 0.03 < np.abs(h1 / truth - 1).mean()


@pytest.mark.heavy
def test_the_stated_uncertainty_is_the_scatter_of_repeated_records():
    repeats = [frf(*records(0.0, 0.5, n=20_000, seed=s)[:2], RATE, 1000) for s in range(60)]
    band = (repeats[0].frequency_hz > 20) & (repeats[0].frequency_hz < 150)
    values = np.array([one.h1[band] for one in repeats])
    scatter = np.std(np.abs(values), axis=0) / np.abs(values.mean(axis=0))
    stated = np.mean([one.u_relative[band] for one in repeats], axis=0)
    assert np.median(scatter / stated) == pytest.approx(1.0, abs=0.15)


def linear_rig(base, rate_hz, info, zeta=0.02):
    """Scans of the linear rig for any base motion, through lag and skew, by the discrete Fourier transform."""
    frequency = np.fft.rfftfreq(len(base), 1 / rate_hz)
    spectrum = np.fft.rfft(base)
    rows = np.zeros(len(base), SCAN)
    for name, ratio in (("base", 1.0), ("laser", linear_transmissibility(frequency, zeta=zeta))):
        rows[name] = np.fft.irfft(spectrum * ratio * channel_response(info, name, frequency), len(base))
    return rows


@pytest.mark.heavy
@pytest.mark.parametrize("waveform", ["chirp", "random"])
def test_a_sweep_recovers_the_transmissibility(waveform):
    """Periodic chirps and random records give the closed form: lag and skew are corrected, the phase is negative."""
    rate, segment = 1000, 20_000
    info = info_rows(rate, gain_u=2e-3)
    time = np.arange(segment) / rate
    rng = np.random.default_rng(2)
    if waveform == "chirp":
        base, options = np.tile(1e-4 * signal.chirp(time, 5.0, time[-1], 15.0), 4), {"window": "boxcar", "overlap": 0.0}
    else:
        base, options = 1e-4 * rng.standard_normal(30 * segment), {}
    found = transmissibility_frf(linear_rig(base, rate, info), info, segment, **options)
    band = (found.frequency_hz > 7) & (found.frequency_hz < 12) & (np.abs(found.frequency_hz - F_N) > 0.3)
    truth = linear_transmissibility(found.frequency_hz[band], zeta=0.02)
    for estimate in (found.h1, found.h2, found.hv):
        assert np.allclose(estimate[band], truth, rtol=0.005 if waveform == "chirp" else 0.05)
        assert np.all(np.angle(estimate[band]) < 0)
    assert np.all(found.coherence[band] > 0.99)
    assert np.all(found.u_relative[band] >= np.hypot(2e-3, 2e-3) * 0.999)


def band_limited(seconds, low_hz, high_hz, rate=200, seed=3):
    frequency = np.fft.rfftfreq(seconds * rate, 1 / rate)
    lines = (
        np.random.default_rng(seed).standard_normal((2, len(frequency))) * (frequency > low_hz) * (frequency < high_hz)
    )
    base = np.fft.irfft(lines[0] + 1j * lines[1], seconds * rate)
    return 1e-4 * base / base.std()


def dip(base, rate, zeta):
    """Reduce a base motion near the resonance of its structure, as a shaker of constant current does."""
    frequency = np.fft.rfftfreq(len(base), 1 / rate)
    return np.fft.irfft(np.fft.rfft(base) / linear_transmissibility(np.maximum(frequency, 0.1), zeta=zeta), len(base))


@pytest.mark.heavy
@pytest.mark.parametrize("zeta", [0.0045, 0.02])
@pytest.mark.parametrize("shaker", [False, True], ids=["prescribed", "current"])
def test_segments_are_long_enough_to_resolve_the_resonance(zeta, shaker):
    """A response is resolved within 2 %, or its uncertainty contains the error, as with segments of 10 s."""
    rate, info = 200, info_rows(200, gain_u=1e-4)
    base = band_limited(1200, 6.0, 12.0)
    rows = linear_rig(dip(base, rate, zeta) if shaker else base, rate, info, zeta)
    rows["base"] += 1e-9 * np.random.default_rng(1).standard_normal(len(rows))
    found = transmissibility_frf(rows, info)
    assert found.resonance.frequency_hz == pytest.approx(F_N, rel=1e-4)
    assert found.resonance.damping_ratio == pytest.approx(zeta, rel=0.02)
    assert 1 / found.frequency_hz[1] == pytest.approx(resolving_s(found.resonance, "hann"), rel=0.01)
    near = np.abs(found.frequency_hz - F_N) < 2 * found.resonance.width_hz
    truth = np.abs(linear_transmissibility(found.frequency_hz, zeta=zeta))
    off = ((np.abs(found.h1) - truth) / (np.abs(found.h1) * found.u_relative))[near]
    assert np.sqrt(np.mean(off**2)) < 1.4  # 33 lines, neighbours alike; 0.8 to 1.3 in 48 draws
    coarse = transmissibility_frf(rows, info, 10 * rate)
    peak = int(np.argmin(np.abs(coarse.frequency_hz - F_N)))
    low = 1 - abs(coarse.h1[peak]) / abs(linear_transmissibility(coarse.frequency_hz[peak], zeta=zeta))
    if zeta < 0.01:
        assert low > 0.2
        assert coarse.bias > low / (1 - low)
    assert low < 2 * coarse.u_relative[peak]


def test_a_record_too_short_for_its_resonance_is_marked_and_a_given_damping_is_used():
    info = info_rows(200)
    rows = linear_rig(band_limited(100, 6.0, 12.0), 200, info, 0.0045)
    found = transmissibility_frf(rows, info)
    assert 1 / found.frequency_hz[1] == pytest.approx(100 / 2.5)
    assert found.bias > 5 * RESOLVED
    asked = transmissibility_frf(rows, info, damping_ratio=0.05)
    assert asked.resonance.damping_ratio == 0.05
    assert asked.bias <= RESOLVED * 1.05


@pytest.mark.heavy
def test_a_periodic_excitation_leaks_nothing_through_a_rectangular_window():
    info = info_rows(200)
    rows = linear_rig(np.tile(band_limited(20, 6.0, 12.0), 30), 200, info, 0.0045)
    assert transmissibility_frf(rows, info, 4000, window="boxcar").bias == 0.0
    assert transmissibility_frf(rows, info, 4100, window="boxcar").bias > 0.3


def test_only_lines_of_the_excitation_count_as_excited():
    """Leakage of a sine and the tails of a band are coherent as well, but not excited."""
    info, time = info_rows(200), np.arange(100 * 200) / 200
    sine = transmissibility_frf(linear_rig(1e-4 * np.sin(2 * np.pi * 9.1 * time), 200, info), info, 2000)
    assert sine.sine
    assert sine.frequency_hz[sine.excited].tolist() == pytest.approx([9.1])
    assert sine.resonance is None
    rows = linear_rig(band_limited(100, 7.0, 12.0), 200, info)
    band = transmissibility_frf(rows, info)
    assert not band.sine
    assert band.frequency_hz[band.excited[0]] > 6.9
    assert band.frequency_hz[band.excited[-1]] < 12.1
    rows["base"] = 1e-9 * np.random.default_rng(1).standard_normal(len(rows))
    assert not len(transmissibility_frf(rows, info).excited), "that is the sensor's own noise"


def test_a_response_without_a_resonance_yields_no_resonance():
    rng = np.random.default_rng(4)
    x = band_limited(100, 6.0, 12.0)
    assert find_resonance(x, x + 1e-4 * rng.standard_normal(len(x)), 200, 6.0, 12.0) is None
    assert find_resonance(x, np.zeros(len(x)), 200, 6.0, 12.0) is None
    assert find_resonance(x, x, 200, 6.0, 6.01) is None


def test_resolution_follows_the_window():
    sharp = [resolution_bias(window, 10_000, 50 / 10_000) for window in ("hann", "blackmanharris", "flattop")]
    assert sharp == sorted(sharp)
    assert resolution_bias("hann", 10_000, 100 / 10_000) == pytest.approx(sharp[0] / 4, rel=0.05)
    assert resolution_bias("hann", 10_000, 0.5 / 10_000) == np.inf


@pytest.mark.parametrize(
    ("x", "y", "segment", "message"),
    [
        (np.ones(100), np.ones(99), 50, "equal length"),
        (np.arange(5.0), np.arange(5.0), 8, "at least 8 samples, got 5"),
        (np.arange(100.0), np.arange(100.0), 101, "segment must be 8 to 100"),
        (np.arange(100.0), np.arange(100.0), 0, "segment must be 8 to 100"),
        (np.arange(100.0), np.full(100, np.nan), 50, "finite"),
        (np.zeros(100), np.arange(100.0), 50, "constant"),
    ],
)
def test_invalid_arguments_are_rejected(x, y, segment, message):
    with pytest.raises(ValueError, match=message):
        frf(x, y, RATE, segment)
