# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Protocol of the WebSocket between page and server: parsing of the page's requests, and frames for the page.

A request is a JSON text: `{"id": 7, "do": "frequency", "value": 9.1}`; `REQUESTS` lists all requests. The server
answers each with a frame REPLY that has the request's id, `ok` (whether it succeeded) and a text, except `ack` and
`view`.

A frame is a binary message, little-endian. It begins with its kind (u1), 3 bytes of padding, and a number (u4). The
rest depends on the kind; times are in seconds since scan 0:

    STATE     JSON: the parts of the snapshot that have changed (state.Snapshot)
    REPLY     JSON: id, ok, text
    TRACE     picture of the scope: begin, length of a column, trigger, now (f8 each), channels u4, columns u4; minima
              f4[channels][columns], maxima likewise, status u1[columns]
    TRACE_B   the same for the scans of a second run
    MOTION    true motion: rows u4, columns u4; each row f8: time, x_b, x_1, x_2, v_b, v_1, v_2
    IMPACTS   true impacts, as MOTION: time, wall, approach speed, separation speed, peak force
    DETECTED  impacts detected by the accelerometer, as MOTION: time, peak, sign
    SPECTRUM  resolution f8 [Hz], count u4, channel u4; amplitudes f4[count]
"""

from __future__ import annotations

import enum
import json
import math
import struct
from collections.abc import Callable, Mapping
from typing import Any  # values of JSON

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.errors import ImpactRigError
from impact_rig.instruments.section import CHANNELS
from impact_rig.system.files import plain
from impact_rig_lab.scope import LONGEST_S, Trace

LONGEST_REQUEST = 65536  # largest request in bytes; a longer one is rejected and the connection is closed
LONGEST_TEXT = 500  # largest number of characters of a text that is published
MOST_COLUMNS = 4000  # largest number of columns of a picture
MOST_FREQUENCIES = 200  # largest number of frequencies of a sweep
LARGEST_ID = 2**53  # largest id of a request: integers up to it are exact in JavaScript


class RequestError(ImpactRigError, ValueError):
    """Error of an invalid request of a page; the message says what is invalid, and the page shows it."""


class FrameKind(enum.IntEnum):
    """Kind of a frame: its first byte, which determines the format of the rest (see the top of this module)."""

    STATE = 1
    REPLY = 2
    TRACE = 3
    MOTION = 4
    IMPACTS = 5
    DETECTED = 6
    SPECTRUM = 7
    TRACE_B = 8


@attrs.frozen
class Request:
    """Parsed and checked request of a page."""

    id: int  # number that the page has given to the request, and that the reply repeats
    do: str  # name of the request, a key of `REQUESTS`
    values: Mapping[str, Any]  # its values by name
    rig: str | None = None  # instance of the rig that the page showed; None if the page did not name one


Check = Callable[[str, object], Any]
"""Function that checks a value of a request, given its name, and returns it, or raises `RequestError`."""


def number(low: float = -math.inf, high: float = math.inf) -> Check:
    """Return a `Check` that accepts a finite number in [low, high] and returns it as a float.

    Any other value, also true or false, raises a RequestError.
    """

    def check(name: str, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise RequestError(f"{name} must be a number, got {_short(value)}")
        try:
            found = float(value)
        except OverflowError as error:
            raise RequestError(f"{name} must be within ±1.8e308, got a number of {len(str(value))} digits") from error
        if not (math.isfinite(found) and low <= found <= high):
            raise RequestError(f"{name} must be a finite number within {low:g} and {high:g}, got {found:g}")
        return found

    return check


def flag(name: str, value: object) -> bool:
    """Check that the value `name` of a request is true or false, and return it.

    Raises:
        RequestError: the value is neither.
    """
    if not isinstance(value, bool):
        raise RequestError(f"{name} must be true or false, got {_short(value)}")
    return value


def word(*known: str) -> Check:
    """Return a `Check` that accepts only the texts in `known`; any other value raises a RequestError."""

    def check(name: str, value: object) -> str:
        if not isinstance(value, str) or value not in known:
            allowed = ", ".join(one or "an empty text" for one in known)
            raise RequestError(f"{name} must be one of {allowed}, got {_short(value)}")
        return value

    return check


def text(name: str, value: object) -> str:
    """Check that the value `name` of a request is a text that can be published on a topic, and return it.

    Raises:
        RequestError: the value is not a text, is longer than `LONGEST_TEXT`, or contains characters that cannot be
            printed, such as line breaks. An empty text is valid.
    """
    if not isinstance(value, str) or len(value) > LONGEST_TEXT or not value.isprintable():
        raise RequestError(f"{name} must be a printable text of at most {LONGEST_TEXT} characters, got {_short(value)}")
    return value


def document(name: str, value: object) -> str:
    """Check that the value `name` of a request is a text, such as the content of a file, and return it.

    Raises:
        RequestError: the value is not a text.
    """
    if not isinstance(value, str):
        raise RequestError(f"{name} must be a text, got {_short(value)}")
    return value


def frequencies(name: str, value: object) -> tuple[float, ...]:
    """Check that the value `name` of a request is a list of frequencies [Hz], and return them.

    Raises:
        RequestError: the value is not a list of 1 to `MOST_FREQUENCIES` numbers within 0.001 and 10000 Hz.
    """
    if not isinstance(value, list) or not 1 <= len(value) <= MOST_FREQUENCIES:
        raise RequestError(f"{name} must be a list with 1 to {MOST_FREQUENCIES} frequencies in Hz, got {_short(value)}")
    return tuple(number(1e-3, 1e4)("each frequency in Hz", one) for one in value)


def _short(value: object) -> str:
    return repr(value)[:80]


_ANY = number(-1e300, 1e300)  # the rig itself checks the range and gives the message
REQUESTS: Mapping[str, Mapping[str, Check]] = {
    "ack": {"frame": number(0, LARGEST_ID)},
    "view": {
        "span": number(0.05, LONGEST_S),
        "columns": number(16, MOST_COLUMNS),
        "trigger": flag,
        "spectrum": word("", *CHANNELS),
        "top": number(1.0, 5e4),
    },
    "frequency": {"value": _ANY},
    "current": {"value": _ANY},
    "gap": {"value": _ANY},
    "start": {"value": text},
    "law": {"value": text},
    "restitution": {"value": _ANY},
    "stop": {},
    "reset": {},
    "pluck": {"value": _ANY},
    "clear_trip": {},
    "pause": {"value": flag},
    "sweep": {
        "frequencies": frequencies,
        "direction": word("up", "down", "up_down"),
        "hold": word("command", "current", "base", "superior", "phase"),
        "target": _ANY,
    },
    "sweep_stop": {},
    "fault": {"kind": text, "channel": text, "value": _ANY, "duration": _ANY, "rate": _ANY},
    "clear_faults": {},
    "load": {"value": document},
    "note": {"value": text},
    "record": {"value": flag},
    "restart": {},
    "recover": {},
    "choose": {"value": text},
    "play": {"value": flag},
    "speed": {"value": number(0.25, 20.0)},
    "seek": {"value": number(-1e9, 1e9)},
    "next_impact": {"value": number(-1, 1)},
    "align": {"value": number(-1e9, 1e9), "by": word("start", "time", "change")},
}
"""Known requests by name, each with the names of its values, all required, and their checks.

Each request may also contain `rig`, the instance of the rig that the page showed.
"""


def parse(raw: str | bytes) -> Request:
    """Parse and check a message from a page as a request.

    Args:
        raw: the message, a JSON object. Its keys `id` (default 0) and `rig` are optional.

    Raises:
        RequestError: the message is too long or no JSON object, the request is unknown, or a value is missing, unknown
            or invalid.
    """
    size = len(raw.encode("utf-8", "replace")) if isinstance(raw, str) else len(raw)
    if size > LONGEST_REQUEST:
        raise RequestError(f"a request must have at most {LONGEST_REQUEST} bytes, got {size}")
    try:
        found = json.loads(raw)
    except (ValueError, RecursionError) as error:  # not JSON, not UTF-8, or nested too deeply
        raise RequestError(f"a request must be a JSON object, got {_short(raw)}") from error
    if not isinstance(found, dict):
        raise RequestError(f"a request must be a JSON object, got {_short(found)}")
    do = found.pop("do", None)
    if not isinstance(do, str) or do not in REQUESTS:
        raise RequestError(f"there is no request {_short(do)}; do must be one of {', '.join(REQUESTS)}")
    identity = number(0, LARGEST_ID)("id", found.pop("id", 0))
    if identity != int(identity):
        raise RequestError(f"id must be a whole number, got {identity:g}")
    rig = found.pop("rig", None)
    if rig is not None:
        rig = text("rig", rig)
    checks = REQUESTS[do]
    if found.keys() != checks.keys():
        raise RequestError(f"{do} takes {', '.join(checks) or 'no values'}, got {_short(sorted(found))}")
    values = {name: check(do if name == "value" else name, found[name]) for name, check in checks.items()}
    return Request(int(identity), do, values, rig)


# Frames

_HEAD = struct.Struct("<BxxxI")
_TRACE = struct.Struct("<4dII")
_ROWS = struct.Struct("<II")
_SPECTRUM = struct.Struct("<dII")


def json_frame(kind: FrameKind, number: int, content: Mapping[str, Any]) -> bytes:
    """Return a frame with JSON content.

    Args:
        kind: STATE or REPLY.
        number: number in the head of the frame, modulo 2³²: 0 for STATE, the id of the request for REPLY.
        content: content for the page; NumPy values are allowed. NaN and infinite numbers become null.
    """
    return _HEAD.pack(kind, number & 0xFFFFFFFF) + json.dumps(plain(content), separators=(",", ":")).encode()


def trace_frame(kind: FrameKind, number: int, trace: Trace, now_s: float) -> bytes:
    """Return a frame with a picture of the scope.

    Args:
        kind: TRACE, or TRACE_B for a second run.
        number: for a TRACE, the number of the frame, which the page acknowledges when it has drawn the frame; for a
            TRACE_B, the epoch of the record (`RigView.epoch`).
        trace: the picture.
        now_s: time that the page shows [s since scan 0 of the first run].
    """
    head = _TRACE.pack(trace.begin_s, trace.column_s, trace.trigger_s, now_s, *trace.low.shape)
    parts = (trace.low.tobytes(), trace.high.tobytes(), trace.status.tobytes())
    return b"".join((_HEAD.pack(kind, number & 0xFFFFFFFF), head, *parts))


def rows_frame(kind: FrameKind, number: int, rows: NDArray[np.float64]) -> bytes:
    """Return a frame with rows of numbers; each row begins with the time [s since scan 0].

    Args:
        kind: MOTION, IMPACTS or DETECTED.
        number: epoch of the record (`RigView.epoch`); a new epoch makes the page drop the rows that it has.
        rows: rows, shape (number of rows, number of columns).
    """
    return _HEAD.pack(kind, number & 0xFFFFFFFF) + _ROWS.pack(*rows.shape) + rows.astype("<f8").tobytes()


def spectrum_frame(number: int, resolution_hz: float, amplitudes: NDArray[np.float32], channel: int) -> bytes:
    """Return a frame with the amplitude spectrum of a channel.

    Args:
        number: epoch of the record, as in `rows_frame`.
        resolution_hz: distance between two lines of the spectrum.
        amplitudes: peak amplitudes of the lines from 0 Hz on, in the unit of the channel.
        channel: index of the channel in `CHANNELS`.
    """
    head = _SPECTRUM.pack(resolution_hz, len(amplitudes), channel)
    return _HEAD.pack(FrameKind.SPECTRUM, number & 0xFFFFFFFF) + head + amplitudes.astype("<f4").tobytes()
