"""Faults of the instruments at exact samples, in the words of a test."""

from __future__ import annotations

import attrs

from impact_rig.config.faults import PlannedFault, parse


@attrs.frozen(kw_only=True)
class Fault:
    """One fault of the instruments; what kinds there are is in docs/interface.md, `truth/faults`.

    Attributes:
        kind: e.g. `lost_block`, `saturation`, `dropout`.
        channel: `accelerometer`, `laser`, `base` or `current`; empty for faults of the whole board.
        start_sample: first scan it acts on, counted from the start or reset.
        samples: how many scans it lasts; 0 = until it is cleared.
        value: its size, in the unit of the channel or as the kind says.
        seed: of its own random numbers.
        rate_hz: mean rate of a spike train.
    """

    kind: str
    channel: str = ""
    start_sample: int = 0
    samples: int = 0
    value: float = 0.0
    seed: int = 0
    rate_hz: float = 0.0

    def line(self, scan_rate_hz: int) -> str:
        """Return the fault as `instruments.faults.planned` takes it.

        Raises:
            ConfigError: no such kind or channel, or a number out of range.
        """
        words = [self.kind, *([f"channel={self.channel}"] if self.channel else [])]
        for key, number in (
            ("start_s", self.start_sample / scan_rate_hz),
            ("duration_s", self.samples / scan_rate_hz),
            ("value", self.value),
            ("seed", self.seed),
            ("rate_hz", self.rate_hz),
        ):
            if number:
                words.append(f"{key}={number!r}")
        line = " ".join(words)
        parse(line)
        return line

    @classmethod
    def from_planned(cls, planned: PlannedFault, scan_rate_hz: int) -> Fault:
        """Return a fault of a configuration."""
        return cls(
            kind=planned.kind,
            channel=planned.channel,
            start_sample=round(planned.start_s * scan_rate_hz),
            samples=round(planned.duration_s * scan_rate_hz),
            value=planned.value,
            seed=planned.seed,
            rate_hz=planned.rate_hz,
        )

    def __str__(self) -> str:
        where = f" on {self.channel}" if self.channel else ""
        until = f"sample {self.start_sample + self.samples}" if self.samples else "the end"
        size = f", value {self.value:g}" if self.value else ""
        return f"{self.kind}{where} from sample {self.start_sample} to {until}{size}"
