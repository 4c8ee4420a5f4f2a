# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a recovered run says about its origin: the `impact_rig/recovered` metadata record."""

from __future__ import annotations

from collections.abc import Mapping

import attrs

from impact_rig.recording.records import DamageError

NAME = "impact_rig/recovered"
"""Metadata record of a run that `recover` has written."""


@attrs.frozen
class Recovered:
    """What a recovery has left out.

    Attributes:
        source: name of the run that was damaged or unfinished.
        damages: places that were left out.
        lost_bytes: how large they were.
        missing_messages: messages the damaged run's index counts and that are not given back; None: it has no index.
        unfinished: whether the damaged run was never finished, so that nobody knows what it should have held.
    """

    source: str
    damages: int
    lost_bytes: int
    missing_messages: int | None
    unfinished: bool

    @property
    def incomplete(self) -> bool:
        """Whether anything is known to be left out."""
        return self.damages > 0 or bool(self.missing_messages)

    def to_record(self) -> dict[str, str]:
        """Return the content of the metadata record."""
        missing = "" if self.missing_messages is None else str(self.missing_messages)
        return {
            "source": self.source,
            "damages": str(self.damages),
            "lost_bytes": str(self.lost_bytes),
            "missing_messages": missing,
            "unfinished": str(int(self.unfinished)),
        }


def read(record: Mapping[str, str]) -> Recovered | None:
    """Return what `Recovered.to_record` wrote; None for a run that was not recovered, which has no such record.

    Raises:
        DamageError: the record holds something else.
    """
    if not record:
        return None
    try:
        missing = record["missing_messages"]
        return Recovered(
            record["source"],
            int(record["damages"]),
            int(record["lost_bytes"]),
            int(missing) if missing else None,
            record["unfinished"] == "1",
        )
    except (KeyError, ValueError) as error:
        raise DamageError(f"the metadata record {NAME!r} cannot be understood: {error}") from error
