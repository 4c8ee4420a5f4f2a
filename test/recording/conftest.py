"""A clock that is told the time, and a recording to fill."""

from kits.recording import clock, record

__all__ = ["clock", "record"]
