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
"""Each figure contains the given data; how it looks is judged by people."""

from __future__ import annotations

import io
import subprocess
import sys

import numpy as np
import pytest
from kits.records import steady_record

from impact_rig.analysis import drawings
from impact_rig.blocks import TRANSMISSIBILITY

pytest.importorskip("matplotlib")


def png(figure):
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()


@pytest.mark.heavy
def test_curves_show_every_valid_row_with_its_uncertainty():
    rows = np.zeros(4, TRANSMISSIBILITY)
    rows["frequency"], rows["transmissibility"] = (9.1, 8.0, 10.0, 9.0), (110.0, 4.4, np.nan, 40.0)
    rows["transmissibility_uncertainty"], rows["phase"], rows["phase_uncertainty"] = 1.0, -1.0, 0.01
    figure = drawings.transmissibility_curves({"no sphere": rows, "6 mm": rows})
    upper, lower = figure.axes
    line = upper.lines[0]
    assert line.get_xdata().tolist() == [8.0, 9.0, 9.1]
    assert line.get_ydata().tolist() == [4.4, 40.0, 110.0]
    segments = upper.collections[0].get_segments()
    assert np.allclose(segments[0], [[8.0, 2.4], [8.0, 6.4]]), "bars are ± 2u long"
    assert np.allclose(lower.lines[0].get_ydata(), np.degrees(-1.0))
    assert png(figure).startswith(b"\x89PNG")


@pytest.mark.heavy
def test_traces_mark_the_impacts():
    rows = steady_record(9.1, 0.5, noise=0)
    figure = drawings.time_traces(rows, np.array([0.1, 0.2]))
    assert [len(axis.lines) for axis in figure.axes] == [2, 2, 2], "the trace, and the marks of the impacts"
    for axis in figure.axes:
        instants, heights = axis.lines[1].get_data()
        assert instants.tolist() == [0.1, 0.2]
        assert np.all(heights > 1.0), "above the axis, in parts of its height: no pulse is hidden"
        assert axis.lines[1].get_transform() == axis.get_xaxis_transform()
    assert np.allclose(figure.axes[1].lines[0].get_ydata(), 1e3 * rows["laser"])
    assert png(figure).startswith(b"\x89PNG")
    assert [len(axis.lines) for axis in drawings.time_traces(rows).axes] == [1, 1, 1]


@pytest.mark.heavy
def test_a_phase_plane_with_few_samples_is_smoothed_over_all_of_them():
    """100 scans at 50 kS/s are shorter than a fortieth of a cycle of 9.1 Hz."""
    x = 1e-3 * np.sin(2 * np.pi * 9.1 * np.arange(100) / 50_000)
    line = drawings.phase_plane(x, 50_000, smooth_s=1 / (40 * 9.1)).axes[0].lines[0]
    np.testing.assert_allclose(line.get_ydata()[50], 2e-3 * np.pi * 9.1 * np.cos(2 * np.pi * 9.1 * 1e-3), rtol=1e-3)


def test_the_phase_plane_of_a_sine_is_an_ellipse():
    rate, amplitude, omega = 10_000.0, 5e-3, 2 * np.pi * 9.1
    x = amplitude * np.cos(omega * np.arange(5000) / rate)
    line = drawings.phase_plane(x, rate).axes[0].lines[0]
    radius = np.hypot(line.get_xdata() * 1e-3 / amplitude, line.get_ydata() / (omega * amplitude))
    assert np.allclose(radius[10:-10], 1.0, atol=1e-4)


def test_the_spectrum_shows_a_sine_at_its_amplitude():
    rate = 1000.0
    y = 3.0 * np.sin(2 * np.pi * 50.0 * np.arange(10_000) / rate) + 7.0
    axis = drawings.spectrum(y, rate, "mm", drive_hz=50.0, upto_hz=200.0).axes[0]
    frequency, amplitude = axis.lines[0].get_data()
    assert frequency[np.argmax(amplitude)] == pytest.approx(50.0)
    assert amplitude.max() == pytest.approx(3.0, rel=1e-3)
    assert len(axis.lines) == 1 + 4, "drive and harmonics up to the end of the axis"
    assert axis.get_ylabel() == "amplitude (mm)"


def test_importing_the_module_loads_no_matplotlib():
    code = "import sys, impact_rig.analysis.drawings; print('matplotlib' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "False"
