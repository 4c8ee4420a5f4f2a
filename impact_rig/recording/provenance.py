# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Where a run comes from: the `impact_rig` metadata record, attachments, and a checksum that guards metadata records.

MCAP protects chunks and attachments with a CRC, metadata records not. Ours carry their own in the key `crc32`, so that
a flipped bit in a seed is found and never believed.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping

import attrs

from impact_rig.arithmetic import ARITHMETIC

RECORD_NAME = "impact_rig"
"""Metadata record with the package version, the seed and the wall-clock start."""
TOPIC_RECORD_NAME = "impact_rig/topic"
"""Metadata record repeating a channel and its schema outside the chunks: a lost chunk does not cost the others."""
CONFIGURATION = "config.yaml"
"""Attachment with the resolved configuration."""

ARITHMETIC_KEY = "arithmetic"
UNWRITTEN_ARITHMETIC = "1"
"""Of recordings from before it was written down."""

_CRC_KEY = "crc32"


@attrs.frozen(kw_only=True)
class Provenance:
    """What a run must say about itself.

    Attributes:
        version: of the package.
        seed: of noise, calibration errors and random drive.
        wall_start_ns: system time when the recording began [ns since the epoch].
        extra: whatever else identifies the run.
        arithmetic: version of the arithmetic that made the samples.
    """

    version: str
    seed: int
    wall_start_ns: int
    extra: Mapping[str, str] = attrs.field(factory=dict)
    arithmetic: int = ARITHMETIC

    def to_record(self) -> dict[str, str]:
        """Return the content of the metadata record."""
        return {
            "version": self.version,
            "seed": str(self.seed),
            "wall_start_ns": str(self.wall_start_ns),
            ARITHMETIC_KEY: str(self.arithmetic),
            **dict(self.extra),
        }

    @classmethod
    def from_record(cls, record: Mapping[str, str]) -> Provenance | None:
        """Return what `to_record` wrote, or None if `record` lacks a part of it."""
        extra = dict(record)
        try:
            version, seed, start = extra.pop("version"), int(extra.pop("seed")), int(extra.pop("wall_start_ns"))
            arithmetic = int(extra.pop(ARITHMETIC_KEY, UNWRITTEN_ARITHMETIC))
        except (KeyError, ValueError):
            return None
        return cls(version=version, seed=seed, wall_start_ns=start, extra=extra, arithmetic=arithmetic)


def arithmetic_of(record: Mapping[str, str]) -> str:
    """Return the version of the arithmetic that a run's metadata record names; of another recorder's file nothing."""
    return record.get(ARITHMETIC_KEY, UNWRITTEN_ARITHMETIC) if record else ""


@attrs.frozen
class Attachment:
    """A file kept inside the recording."""

    name: str
    data: bytes
    media_type: str = "application/octet-stream"


def protect(record: Mapping[str, str]) -> dict[str, str]:
    """Return `record` with its checksum."""
    content = {key: value for key, value in record.items() if key != _CRC_KEY}
    return {**content, _CRC_KEY: f"{_checksum(content):08x}"}


def verify(record: Mapping[str, str]) -> dict[str, str] | None:
    """Return `record` without its checksum, or None if it has none or it does not fit."""
    content = {key: value for key, value in record.items() if key != _CRC_KEY}
    return content if record.get(_CRC_KEY) == f"{_checksum(content):08x}" else None


def _checksum(content: Mapping[str, str]) -> int:
    crc = 0
    for key, value in sorted(content.items()):
        for text in (key.encode(), value.encode()):
            crc = zlib.crc32(struct.pack("<Q", len(text)) + text, crc)
    return crc
