# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Which rig time a message is logged at: its header stamp, or for header-less topics the newest scan's last instant."""

from __future__ import annotations

from impact_rig import codec
from impact_rig.errors import CodecError
from impact_rig.recording.description import INFINITE_NS
from impact_rig.simtime import NS_PER_S

_LONGEST_BLOCK_S = 1e6  # a `time` beyond this (or none at all, or NaN) is no instant of a block


class LogTime:
    """Follows rig time through the stamps of the messages; reads no clock.

    Args:
        rig_start_ns: rig time before any stamp is known; None: the message's publish time is taken until then.
    """

    def __init__(self, rig_start_ns: int | None = None) -> None:
        self._newest_ns = rig_start_ns
        self._scans_seen = False

    def of(self, data: bytes, publish_time_ns: int, *, has_header: bool, is_scan: bool) -> int:
        """Return the log time [ns, not negative] of a message received now.

        A stamp of zero is a header nobody filled in (or the first instant of a rig that starts at 0, where the fallback
        is zero as well), and bytes too short for a header have none: both are logged like header-less messages.
        """
        block = _block(data) if is_scan else None
        if block is not None:
            stamp, self._newest_ns = block
            self._scans_seen = True
            return _clamp(stamp)
        stamp = _stamp(data) if has_header else 0
        if stamp > 0:
            if not self._scans_seen:
                self._newest_ns = max(stamp, self._newest_ns or 0)
            return stamp
        return _clamp(publish_time_ns if self._newest_ns is None else self._newest_ns)


def _clamp(time_ns: int) -> int:
    """Return what rosbag2 can read: its times are signed, MCAP's are not."""
    return min(max(0, time_ns), INFINITE_NS)


def _stamp(data: bytes) -> int:
    try:
        return codec.header_stamp_ns(data)
    except CodecError:
        return 0


def _block(data: bytes) -> tuple[int, int] | None:
    """Return the times of a block's first and last scan, or None if it is no table with a sound `time` column."""
    try:
        table = codec.decode(data)
    except CodecError:
        return None
    if not len(table.rows) or "time" not in (table.rows.dtype.names or ()):
        return None
    last_s = float(table.rows["time"][-1])
    return (table.stamp_ns, table.stamp_ns + round(last_s * NS_PER_S)) if abs(last_s) < _LONGEST_BLOCK_S else None
