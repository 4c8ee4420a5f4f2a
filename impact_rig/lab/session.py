# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""One open page: draws what it asked for, one picture at a time; a page that does not draw costs nothing."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import deque
from typing import Any  # values of a view, checked by the protocol

from aiohttp import WSMsgType, web

from impact_rig.instruments.scan import CHANNELS
from impact_rig.lab import protocol
from impact_rig.lab.protocol import Kind, Request, RequestError
from impact_rig.lab.scope import Scope, Trace, spectrum
from impact_rig.lab.source import Source

FASTEST_HZ = 60.0
"""Pictures per second, at most."""
MOST_UNDRAWN = 2
"""Pictures on their way to a page: one is drawn while the next travels."""
SPECTRUM_S = 0.25
"""Between two spectra."""
SPECTRUM_SPAN_S = 2.0
STATE_S = 0.1
PATIENCE_S = 2.0
"""A page that has not drawn the last picture after this long is away, and gets one now and then."""
MOST_BAD = 20
"""Requests without sense after which a connection is closed."""


class Session:
    """Serves one WebSocket.

    Args:
        socket: prepared.
        source: what is shown.
        refused: counts what was refused, by reason.
    """

    def __init__(self, socket: web.WebSocketResponse, source: Source, refused: dict[str, int]) -> None:
        self._socket = socket
        self._source = source
        self._refused = refused
        self._view: dict[str, Any] = {"span": 0.5, "columns": 600, "trigger": True, "spectrum": "", "top": 100.0}
        self._frame = self._acknowledged = 0
        self._sent_at = self._state_at = self._spectrum_at = 0.0
        self._version = 0
        self._epoch = -1
        self._seen = {Kind.MOTION: 0, Kind.IMPACTS: 0, Kind.DETECTED: 0}
        self._drawn_end = -1.0
        self._replies: deque[bytes] = deque()
        self._answered = asyncio.Event()
        self._loop = asyncio.get_running_loop()

    async def run(self) -> None:
        """Serve until the page goes."""
        sender = asyncio.create_task(self._send())
        try:
            await self._listen()
        finally:
            sender.cancel()
            with contextlib.suppress(asyncio.CancelledError, ConnectionError):
                await sender

    async def _listen(self) -> None:
        bad = 0
        async for message in self._socket:
            if message.type is WSMsgType.ERROR:
                return  # too long, or no WebSocket's: the connection is closed
            if message.type is not WSMsgType.TEXT:
                self._refuse("binary")
                bad += 1
            else:
                try:
                    self._take(protocol.parse(message.data))
                except RequestError as error:
                    self._refuse("malformed")
                    bad += 1
                    self._reply(0, False, str(error))
            if bad >= MOST_BAD:
                await self._socket.close(code=1008, message=b"too many requests without sense")

    def _refuse(self, reason: str) -> None:
        self._refused[reason] = self._refused.get(reason, 0) + 1

    def _take(self, request: Request) -> None:
        if request.do == "ack":
            self._acknowledged = max(self._acknowledged, min(int(request.values["frame"]), self._frame))
        elif request.do == "view":
            self._view = dict(request.values)
            self._drawn_end = -1.0
            self._spectrum_at = 0.0
        else:
            self._source.ask(request, lambda ok, text: self._reply(request.id, ok, text))

    def _reply(self, number: int, ok: bool, text: str) -> None:
        frame = protocol.json_frame(Kind.REPLY, number, {"id": number, "ok": ok, "text": text})
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            self._loop.call_soon_threadsafe(self._queue, frame)

    def _queue(self, frame: bytes) -> None:
        self._replies.append(frame)
        self._answered.set()

    async def _send(self) -> None:
        """Send replies at once, and pictures when the last one was drawn."""
        while not self._socket.closed:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._answered.wait(), 1.0 / FASTEST_HZ)
            self._answered.clear()
            while self._replies:
                await self._send_state()  # what is in force now comes before the answer
                await self._socket.send_bytes(self._replies.popleft())
            now = time.monotonic()
            if now - self._state_at >= STATE_S:
                self._state_at = now
                await self._send_state()
            if self._frame - self._acknowledged >= MOST_UNDRAWN and now - self._sent_at < PATIENCE_S:
                continue
            frames = self._picture(now)
            if frames:
                self._sent_at = now
                for frame in frames:
                    await self._socket.send_bytes(frame)

    async def _send_state(self) -> None:
        version, parts = self._source.snapshot.since(self._version)
        if parts:
            self._version = version
            await self._socket.send_bytes(protocol.json_frame(Kind.STATE, 0, parts))

    def _picture(self, now: float) -> list[bytes]:
        """Return the frames of one picture; the trace comes last, and is the one that is acknowledged."""
        source, view = self._source, self._view
        with source.lock:
            if source.epoch != self._epoch:
                self._epoch, self._drawn_end = source.epoch, -1.0
                self._seen = dict.fromkeys(self._seen, 0)
            scope, motion = source.scope, source.motion
            if scope is None or scope.end_s == self._drawn_end:
                return []
            trace = self._trace(scope)
            if trace is None:
                return []
            self._drawn_end = scope.end_s
            frames = []
            for kind, rows in (
                (Kind.MOTION, motion.states),
                (Kind.IMPACTS, motion.impacts),
                (Kind.DETECTED, motion.detected),
            ):
                if rows.count > self._seen[kind]:
                    frames.append(protocol.rows_frame(kind, self._epoch, rows.since(self._seen[kind])))
                self._seen[kind] = rows.count
            channel = view["spectrum"]
            if channel and now - self._spectrum_at >= SPECTRUM_S:
                self._spectrum_at = now
                number = CHANNELS.index(channel)
                found = spectrum(scope.stretch(SPECTRUM_SPAN_S)[number], scope.rate_hz, view["top"])
                frames.append(protocol.spectrum_frame(self._epoch, *found, number))
            other = self._trace(source.other) if source.other is not None else None
            if other is not None:
                frames.append(protocol.trace_frame(Kind.TRACE_B, self._epoch, other, source.now_s))
            self._frame += 1
            frames.append(protocol.trace_frame(Kind.TRACE, self._frame, trace, source.now_s))
        return frames

    def _trace(self, scope: Scope) -> Trace | None:
        view = self._view
        return scope.window(view["span"], int(view["columns"]), trigger=view["trigger"])
