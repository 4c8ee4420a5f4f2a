# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The configuration's `instruments` section: the board, what every rig has of faults, and a section per instrument.

Tolerances are limits: the rig draws its errors once per seed, evenly within them; the analysis knows only the limits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any  # attrs attributes of any type

import attrs

from impact_rig.config.fields import switch
from impact_rig.errors import ConfigError
from impact_rig.instruments.adc import ADC_RANGES_V, Adc
from impact_rig.instruments.fault import FaultPlan
from impact_rig.instruments.instrument import Instrument
from impact_rig.instruments.registry import INSTRUMENTS


def _with_instruments(_section: type, own: list[attrs.Attribute[Any]]) -> list[attrs.Attribute[Any]]:
    """Return the section's attributes, those of the instruments behind the first."""
    fields = {name: attrs.field(factory=kind, type=kind) for name, kind in INSTRUMENTS.items()}
    return [own[0], *attrs.fields(attrs.make_class("_", fields, kw_only=True)), *own[1:]]


@attrs.frozen(kw_only=True, field_transformer=_with_instruments)
class Instruments:
    """All instruments of the rig, each by the name of its channel."""

    ideal: bool = switch(False, "Ideal instruments: no noise, calibration error, lag, skew, quantisation or range.")
    adc: Adc = attrs.field(factory=Adc)
    faults: FaultPlan = attrs.field(factory=FaultPlan)

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Return an instrument; the registry knows which there are."""

    def __attrs_post_init__(self) -> None:
        for instrument in self.all():
            chosen = instrument.adc_range_v
            if chosen not in ADC_RANGES_V:
                ranges = ", ".join(f"{volt:g}" for volt in ADC_RANGES_V)
                raise ConfigError(f"{instrument.name}.adc_range_v must be one of {ranges} V, got {chosen:g} V")
        fitted = {"", *(instrument.name for instrument in self.fitted())}
        for fault in self.faults.faults(scan_rate_hz=1):
            if fault.channel not in fitted:
                raise ConfigError(
                    f"faults.planned: {fault.kind} needs a channel that is present, {fault.channel} is not"
                )

    def all(self) -> tuple[Instrument, ...]:
        """Return every instrument, in scan order."""
        return tuple(getattr(self, name) for name in INSTRUMENTS)

    def fitted(self) -> tuple[Instrument, ...]:
        """Return those that are scanned."""
        return tuple(instrument for instrument in self.all() if instrument.fitted)
