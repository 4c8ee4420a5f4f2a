"""Which rig time a message is logged at: its header stamp, or for header-less topics the newest scan's last instant."""

from __future__ import annotations

from impact_rig import codec
from impact_rig.errors import CodecError
from impact_rig.simtime import NS_PER_S


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
        stamp = _stamp(data) if has_header else 0
        if is_scan:
            self._newest_ns = _last_instant_ns(data, stamp)
            self._scans_seen = True
            return max(0, stamp)
        if stamp > 0:
            if not self._scans_seen:
                self._newest_ns = max(stamp, self._newest_ns or 0)
            return stamp
        return max(0, publish_time_ns if self._newest_ns is None else self._newest_ns)


def _stamp(data: bytes) -> int:
    try:
        return codec.header_stamp_ns(data)
    except CodecError:
        return 0


def _last_instant_ns(data: bytes, stamp_ns: int) -> int:
    """Return the time of the last scan in a block; the block's stamp if it is no table with a `time` column."""
    try:
        rows = codec.decode(data).rows
    except CodecError:
        return stamp_ns
    if not len(rows) or rows.dtype.names is None or "time" not in rows.dtype.names:
        return stamp_ns
    return stamp_ns + round(float(rows["time"][-1]) * NS_PER_S)
