"""Example (c): an analysis held against a recorded run and what it found in it when it was right.

`data/run` was written by `pytest --rig-update-golden`, and is an MCAP run like any other: a run from a laboratory
does as well. `golden/` holds what the analysis found in it.
"""

from pathlib import Path

import pytest
from analyse_run import analyse

from impact_rig.testing import Golden

DATA = Path(__file__).parent / "data"
GOLDEN = DATA.parent / "golden" / "test_regression"
RUN = DATA / "run"
REFERENCE = {"sphere.present": False, "daq.rate_hz": 1000, "daq.block_scans": 50, "drive.amplitude": 0.3}
ROUNDING = {"laser": 1e-3, "base": 1e-3, "accelerometer": 10.0, "current": 0.1}
"""A hundred steps of the converter: another CPU rounds the last bit elsewhere, and a reading may flip."""


@pytest.fixture(scope="session", autouse=True)
def reference_run(request):
    """Record the reference anew where golden data is asked for."""
    if request.config.getoption("--rig-update-golden"):
        from impact_rig.testing import VirtualRig

        rig = VirtualRig({**REFERENCE, "drive.frequency_hz": 8.5})
        rig.run(seconds=5)
        Golden(DATA, update=True).run(rig)


def test_the_analysis_finds_what_it_found(golden):
    golden.values(analyse(RUN), rel=1e-6)


def test_what_it_found_is_right(virtual_rig):
    rig = virtual_rig(REFERENCE)
    expected = rig.expected_transmissibility(8.5)
    assert analyse(RUN)["transmissibility"] == pytest.approx(abs(expected), rel=0.01)


def test_a_change_of_the_analysis_is_noticed():
    """Somebody drops the correction of the laser's lag: 0.7 ms are 2 degrees at 8.5 Hz."""
    kept = Golden(
        Path(__file__).parent / "golden" / "test_regression" / "test_the_analysis_finds_what_it_found", update=False
    )
    with pytest.raises(AssertionError, match="phase_deg"):
        kept.values(analyse(RUN, correct_lag=False), rel=1e-6)


def test_the_rig_still_gives_the_recorded_samples(virtual_rig):
    """The other way round: the rig itself is under test, with tolerances for another CPU."""
    rig = virtual_rig({**REFERENCE, "drive.frequency_hz": 8.5})
    rig.run(seconds=5)
    Golden(DATA, update=False).run(rig, tolerances=ROUNDING)
