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
"""The plot topics: their contents for a plotter, and no work without a subscriber."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig

from impact_rig import topics
from impact_rig.analysis.sine import fit_sine
from impact_rig.client import Client, Collector, isolated_domain
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.nodes.messages import ENVELOPES, SPECTRA, TOPICS, nanoseconds
from impact_rig.nodes.plot_node import PlotDataNode
from impact_rig.simtime import NS_PER_S

pytestmark = pytest.mark.ros
PLOTS = [topics.PLOT_DRIVE, topics.PLOT_PULSES, *SPECTRA.values(), *ENVELOPES.values()]
RATE = 2000


@pytest.fixture(scope="module")
def plotted() -> Iterator[tuple[Client, dict[str, Collector], Collector]]:
    """Rig in lockstep at resonance without the sphere; a plotter receives 6 s of it."""
    with isolated_domain() as domain_id, Client(domain_id) as client:
        client.host(AnalysisNode)
        plot = client.host(PlotDataNode)
        host_rig(
            client,
            time__peers=["analysis"],
            daq__rate_hz=RATE,
            daq__block_scans=40,
            drive__amplitude=0.1,
            sphere__present=False,
        )
        client.wait_active("rig", "analysis", "plot")
        client.step(5)
        assert plot.doing().word == "idle", "without a subscriber no scans are followed"
        heard = {topic.name: client.collect(topic.name) for topic in PLOTS}
        client.wait_until(lambda: plot.doing().word == "plotting", "the scans")
        scans = client.collect("daq/scan")
        client.step(295)
        client.wait_until(lambda: len(heard["plot/spectrum/laser"]) >= 2, "the spectra")
        yield client, heard, scans


def test_plots_are_stamped_in_a_frame_of_the_tree(plotted) -> None:
    for name, collector in plotted[1].items():
        stamps = [nanoseconds(message.header.stamp) for message in collector.messages]
        assert stamps == sorted(stamps)
        assert stamps[-1] > 0
        assert {message.header.frame_id for message in collector.messages} == {"daq"}, name


def test_envelopes_are_published_fifty_times_a_second_and_cover_every_scan(plotted) -> None:
    _, heard, scans = plotted
    for channel, topic in ENVELOPES.items():
        received = heard[topic.name].messages
        stamps = np.array([nanoseconds(message.header.stamp) for message in received])
        assert set(np.diff(stamps)) == {NS_PER_S // 50}
        by_stamp = {table.stamp_ns: table.rows[channel] for table in scans.tables()}
        for message, stamp in zip(received, stamps, strict=True):
            if stamp in by_stamp:
                values = by_stamp[stamp]
                assert (message.vector.x, message.vector.y) == (values.min(), values.max())
                assert message.vector.z == pytest.approx(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("channel", SPECTRA)
def test_the_drive_line_of_the_published_spectrum_is_the_fitted_sine(plotted, channel: str) -> None:
    _, heard, scans = plotted
    message = heard[SPECTRA[channel].name].messages[-1]
    last_ns = nanoseconds(message.header.stamp)
    rows, end_ns = scans.rows(), scans.tables()[-1].stamp_ns + 40 * NS_PER_S // RATE
    rows = rows[: len(rows) - (end_ns - last_ns) * RATE // NS_PER_S + 1][-4 * RATE :]
    points = np.array([(point.x, point.y) for point in message.polygon.points])
    assert points[:, 0] == pytest.approx(np.arange(1001) * 0.25)
    fit = fit_sine(rows[channel], RATE, 9.1, harmonics=3)
    assert points[30:45, 1].max() == pytest.approx(fit.amplitude, rel=0.005)


def test_the_drive_is_published_again_each_second(plotted) -> None:
    messages = plotted[1]["plot/drive"].messages
    assert {(message.vector.x, message.vector.y) for message in messages} == {(9.1, 0.1)}
    assert len(messages) >= 5


def test_topics_for_plotters_and_acknowledgements_are_not_recorded() -> None:
    assert {topic.name for topic in TOPICS if not topic.recorded} == {
        topics.ACK.name,
        topics.PLOT_TRANSMISSIBILITY.name,
        *(topic.name for topic in PLOTS),
    }


def test_a_measurement_has_uncertainty_and_phase_and_is_latched(plotted) -> None:
    client = plotted[0]
    table = client.collect("transmissibility/table")
    client.set_parameters("rig", {"structure.damping_ratio": 0.05})
    client.wait_until(lambda: client.step(50) and any(rows["settled"][0] == 1 for rows in _rows(table)), "a row", 60.0)
    (row, *_) = [rows[0] for rows in reversed(_rows(table)) if rows["settled"][0] == 1]
    late = client.collect("plot/transmissibility")
    client.wait_until(lambda: late.messages, "the latched message")
    vector = late.messages[-1].vector
    expected = (row["transmissibility"], row["transmissibility_uncertainty"], row["phase"])
    assert (vector.x, vector.y, vector.z) == expected


def _rows(collector: Collector) -> list[np.ndarray]:
    return [table.rows for table in collector.tables()]
