"""Configuration of the instruments: catalogue values of the paper's sensors and of the DAQ board."""

from __future__ import annotations

import attrs

from impact_rig.config.fields import switch


@attrs.frozen(kw_only=True)
class Instruments:
    """All instruments of the rig."""

    ideal: bool = switch(False, "Ideal instruments: no noise, no calibration error, no lag, no quantisation.")
