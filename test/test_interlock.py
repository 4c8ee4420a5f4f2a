"""What protects the shaker: limits that cannot be got round, and the interlock on the true motion."""

from __future__ import annotations

import pytest

from impact_rig.config import RigConfig, from_flat
from impact_rig.errors import ConfigError
from impact_rig.rig import Rig
from impact_rig.simtime import COMMAND_GRID_NS

TICK = COMMAND_GRID_NS


def config(**values: object) -> RigConfig:
    return from_flat(RigConfig(), {name.replace("__", "."): value for name, value in values.items()})


def test_a_new_kind_of_drive_waits_for_the_reset_and_does_not_switch_the_interlock_off() -> None:
    """A bug once: the watch looked at the kind of drive of the next reset."""
    rig = Rig(config(drive__frequency_hz=8.0, shaker__travel_limit_m=2e-3))
    rig.configure({"drive.kind": "prescribed"})
    rig.command(current_a=5.0)
    rig.advance(200 * TICK)
    assert rig.latched is not None
    assert rig.latched.startswith("over_travel")


def test_an_initial_drive_that_the_shaker_refuses_is_refused_when_it_is_set() -> None:
    rig = Rig(config())
    with pytest.raises(ConfigError, match=r"drive: current must be"):
        rig.configure({"drive.amplitude": 30.0})
    assert rig.config == config()


def test_a_reset_that_cannot_begin_changes_nothing() -> None:
    """A bug once: the new start was noted before the initial drive was refused, and time jumped."""
    rig, twin = Rig(config(drive__amplitude=2.0)), Rig(config(drive__amplitude=2.0))
    for one in (rig, twin):
        one.advance(20 * TICK)
        one.configure({"shaker.current_limit_a_rms": 1.0})  # below what the next reset would begin with
    with pytest.raises(ConfigError, match="drive: current"):
        rig.reset()
    assert (rig.start_ns, rig.frontier_ns) == (twin.start_ns, twin.frontier_ns)
    for one, two in zip(rig.advance(40 * TICK), twin.advance(40 * TICK), strict=True):
        assert one.scan.rows.tobytes() == two.scan.rows.tobytes()
    assert [t.rows.tobytes() for t in rig.take_journal()] == [t.rows.tobytes() for t in twin.take_journal()]
