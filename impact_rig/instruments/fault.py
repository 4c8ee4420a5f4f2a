"""Configuration of faults that are planned before a run: one line of text per fault.

    offset_step channel=laser start_s=2 duration_s=0.5 value=1e-3 seed=7

`duration_s=0` (the default) lasts until it is cleared; `channel` is left out for faults of the whole board.
"""

from __future__ import annotations

import math

import attrs

from impact_rig.blocks import CHANNELS
from impact_rig.config.fields import names
from impact_rig.errors import ConfigError

FAULT_KINDS = {
    "dropout": "the cable is open: 0 V at the converter",
    "stuck": "the converter repeats its last code",
    "offset_step": "`value` [unit of the channel] is added",
    "gain_error": "the signal grows by the fraction `value`",
    "spike_train": "`rate_hz` spikes per second of ± `value` [unit], at random",
    "saturation": "the signal is limited to ± `value` [unit] and flagged",
    "added_noise": "white noise of `value` rms [unit] is added",
    "lost_block": "blocks are numbered but not published",
    "clock_drift": "the scan clock is off by `value` ppm, on top of daq.clock_error_ppm",
}
BOARD_KINDS = frozenset({"lost_block", "clock_drift"})
"""Faults of the whole board: their channel is empty."""

_NUMBERS = {"start_s": 0.0, "duration_s": 0.0, "value": 0.0, "seed": 0.0, "rate_hz": 0.0}


@attrs.frozen
class PlannedFault:
    """One fault as a configuration names it; times in seconds since reset."""

    kind: str
    channel: str
    start_s: float
    duration_s: float
    value: float
    seed: int
    rate_hz: float


def check_kind(kind: str, channel: str) -> None:
    """Refuse a kind that does not exist, or a channel that does not go with it.

    Raises:
        ConfigError: names what is known.
    """
    if kind not in FAULT_KINDS:
        raise ConfigError(f"fault kind must be one of {', '.join(FAULT_KINDS)}, got {kind!r}")
    if kind in BOARD_KINDS and channel:
        raise ConfigError(f"{kind} is a fault of the whole board and takes no channel, got {channel!r}")
    if kind not in BOARD_KINDS and channel not in CHANNELS:
        raise ConfigError(f"{kind} needs a channel, one of {', '.join(CHANNELS)}, got {channel!r}")


def parse(line: str) -> PlannedFault:
    """Return the fault that one line of text describes.

    Raises:
        ConfigError: unknown kind, channel or key, or a value that is no number or out of range.
    """
    kind, *pairs = line.split() or [""]
    texts = dict(pair.partition("=")[::2] for pair in pairs)
    channel = texts.pop("channel", "")
    check_kind(kind, channel)
    values = dict(_NUMBERS)
    for key, text in texts.items():
        if key not in values:
            raise ConfigError(f"key of a fault must be one of channel, {', '.join(_NUMBERS)}, got {key!r} in {line!r}")
        try:
            values[key] = float(text)
        except ValueError as error:
            raise ConfigError(f"{key} of a fault must be a number, got {text!r} in {line!r}") from error
        if not math.isfinite(values[key]) or (key != "value" and values[key] < 0):
            rule = "finite" if key == "value" else "finite and >= 0"
            raise ConfigError(f"{key} of a fault must be {rule}, got {text} in {line!r}")
    return PlannedFault(
        kind, channel, values["start_s"], values["duration_s"], values["value"], int(values["seed"]), values["rate_hz"]
    )


@attrs.frozen(kw_only=True)
class Faults:
    """Faults on demand, planned from the start; off by default."""

    planned: tuple[str, ...] = names(
        (), "Faults: `kind channel=... start_s=... duration_s=... value=...`; start_s from the reset, or from when set."
    )

    def __attrs_post_init__(self) -> None:
        try:
            self.parsed()
        except ConfigError as error:
            raise ConfigError(f"planned: {error}") from error

    def parsed(self) -> tuple[PlannedFault, ...]:
        """Return the planned faults.

        Raises:
            ConfigError: a line is wrong; the message quotes it.
        """
        return tuple(parse(line) for line in self.planned if line.split())
