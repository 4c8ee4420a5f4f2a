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
"""Web server of the laboratory: it serves the page, and a WebSocket for each open page, to clients with the token.

By default the server is reachable only from this machine. The page fetches nothing from other sites, and the content
security policy forbids it. Each open page has a `PageSession`, which sends the next picture only when the page has
drawn an earlier one. A hidden page therefore costs almost nothing. A page that requests recorded runs (`?run=NAME`)
gets a player of its own.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import importlib.util
import ipaddress
import logging
import os
import secrets
import socket
import threading
import time
from collections import Counter, deque
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any  # values of a view, checked by the protocol

from aiohttp import WSMsgType, web

from impact_rig.errors import ImpactRigError
from impact_rig.instruments.section import CHANNELS
from impact_rig.system import files
from impact_rig_lab import protocol
from impact_rig_lab.playback import PlaybackSource
from impact_rig_lab.protocol import FrameKind, Request, RequestError
from impact_rig_lab.scope import Scope, Trace, spectrum
from impact_rig_lab.state import Source
from impact_rig_lab.theory import lower_priority

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]
STATIC = Path(__file__).parent / "static"
LOOPBACK = "127.0.0.1"
PORT = 8765  # default port of the page
HIGHEST_PORT = 65535
HTTP_PORT = 80  # port that browsers omit from an address
MOST_PAGES = 16  # largest number of pages open at once
FASTEST_HZ = 60.0  # largest number of pictures per second
MOST_UNDRAWN = 2  # largest number of pictures sent but not drawn yet: one is drawn while the next one is sent
SPECTRUM_S = 0.25  # interval between two spectra
SPECTRUM_SPAN_S = 2.0  # length of the scans of a spectrum
STATE_S = 0.1  # interval between two updates of the state
# time after which a page that has not drawn the last picture counts as inactive; it gets a picture once in this time
PATIENCE_S = 2.0
MAX_INVALID = 20  # number of invalid requests after which a connection is closed
HEADERS_S = 10.0  # time after which a connection without a complete request is closed
MOST_CONNECTIONS = 64  # far below the limit of descriptors of a process; further connections are rejected
NO_DESCRIPTOR_S = 0.1  # delay until the next connection is accepted after a failure
MOST_RUNS = 200  # largest number of recorded runs that are listed
MOST_AT_ONCE = 2  # largest number of runs on one page
TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
_WRONG_ADDRESS = "the token in the address is missing or wrong: copy the address from the terminal of the lab"
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


def check_port(port: int) -> None:
    """Check the number of a TCP port.

    Raises:
        ImpactRigError: `port` is not within 0 and 65535.
    """
    if not 0 <= port <= HIGHEST_PORT:
        raise ImpactRigError(f"a port must be 0 (any) to {HIGHEST_PORT}, got {port}")


def plotter_files() -> Path:
    """Return the folder with uPlot, the JavaScript library that draws the page's curves.

    It is part of the Python package `uplot-python`, which need not be imported for this.

    Raises:
        ImpactRigError: the package is not installed.
    """
    found = importlib.util.find_spec("uplot")
    if found is None or found.origin is None:
        raise ImpactRigError("the lab needs uPlot, which draws its curves: pip install uplot-python")
    return Path(found.origin).parent / "static"


def kept_token() -> str:
    """Return the secret token that the address of the page contains, so that only this user can open the page.

    The token is stored in a file that only the user can read, so an open page can reconnect after a restart of the lab.
    If the token cannot be stored, it is valid for this start only. A stored token that other users can read is
    replaced.
    """
    path = files.state_dir("") / "lab_token"
    with contextlib.suppress(OSError, UnicodeDecodeError):
        found = path.read_text(encoding="ascii").strip()
        if len(found) >= 32 and found.isalnum() and path.stat().st_mode & 0o077 == 0:
            return found
    token = secrets.token_hex(24)
    with contextlib.suppress(OSError):  # if it cannot be stored, it is valid for this start only
        path.unlink(missing_ok=True)
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "w", encoding="ascii") as file:
            file.write(token)
    return token


class PageSession:
    """Session of one open page over its WebSocket: it receives requests, and sends pictures, state and replies.

    Args:
        socket: the WebSocket.
        source: live rig or recorded runs that the page shows.
        refused: counts of rejected requests by reason, shared with the server.
    """

    def __init__(self, socket: web.WebSocketResponse, source: Source, refused: Counter[str]) -> None:
        self._socket = socket
        self._source = source
        self._refused = refused
        self._view: dict[str, Any] = {"span": 0.5, "columns": 600, "trigger": True, "spectrum": "", "top": 100.0}
        self._frame = self._acknowledged = 0
        self._sent_at = self._state_at = self._spectrum_at = 0.0
        self._spectrum_end = -1.0
        self._version = 0
        self._epoch = -1
        self._seen = {FrameKind.MOTION: 0, FrameKind.IMPACTS: 0, FrameKind.DETECTED: 0}
        self._drawn_end = -1.0
        self._replies: deque[bytes] = deque()
        self._answered = asyncio.Event()
        self._loop = asyncio.get_running_loop()

    async def run(self) -> None:
        """Serve the page until it disconnects, or sends too long a message or `MAX_INVALID` invalid requests."""
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
                return  # too long, or not a WebSocket message: the connection is closed
            if message.type is not WSMsgType.TEXT:
                self._refused["binary"] += 1
                bad += 1
            else:
                try:
                    self._take(protocol.parse(message.data))
                except RequestError as error:
                    self._refused["malformed"] += 1
                    bad += 1
                    self._reply(0, False, str(error))
            if bad >= MAX_INVALID:
                await self._socket.close(code=1008, message=b"too many invalid requests")

    def _take(self, request: Request) -> None:
        if request.do == "ack":
            self._acknowledged = max(self._acknowledged, min(int(request.values["frame"]), self._frame))
        elif request.do == "view":
            self._view = dict(request.values)
            self._drawn_end = self._spectrum_end = -1.0
            self._spectrum_at = 0.0
        else:
            self._source.ask(request, lambda ok, text: self._reply(request.id, ok, text))

    def _reply(self, number: int, ok: bool, text: str) -> None:
        frame = protocol.json_frame(FrameKind.REPLY, number, {"id": number, "ok": ok, "text": text})
        with contextlib.suppress(RuntimeError):  # the loop may have ended meanwhile
            self._loop.call_soon_threadsafe(self._queue, frame)

    def _queue(self, frame: bytes) -> None:
        self._replies.append(frame)
        self._answered.set()

    async def _send(self) -> None:
        """Send replies at once, the state at intervals, and a picture as soon as the page has drawn an earlier picture.

        A page that does not draw receives a picture every `PATIENCE_S`.
        """
        while not self._socket.closed:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._answered.wait(), 1.0 / FASTEST_HZ)
            self._answered.clear()
            while self._replies:
                await self._send_state()  # the state for the page is up to date before the answer
                await self._socket.send_bytes(self._replies.popleft())
            now = time.monotonic()
            if now - self._state_at >= STATE_S:
                self._state_at = now
                await self._send_state()
            if self._frame - self._acknowledged >= MOST_UNDRAWN and now - self._sent_at < PATIENCE_S:
                continue
            try:
                frames = self._picture(now)
            except Exception:  # a failed picture must not prevent STOP, which is requested here
                self._refused["pictures"] += 1
                continue
            if frames:
                self._sent_at = now
                for frame in frames:
                    await self._socket.send_bytes(frame)

    async def _send_state(self) -> None:
        version, parts = self._source.snapshot.since(self._version)
        if parts:
            self._version = version
            await self._socket.send_bytes(protocol.json_frame(FrameKind.STATE, 0, parts))

    def _picture(self, now: float) -> list[bytes]:
        """Return the frames of the next picture; none if nothing is new, or if the ring buffers are being filled.

        The last frame is the TRACE, which the page acknowledges when it has drawn the picture.

        Args:
            now: present time (`time.monotonic`), which decides whether a spectrum is due.
        """
        source, record, view = self._source, self._source.record, self._view
        with contextlib.ExitStack() as stack:
            if not record.lock.acquire(blocking=False):
                return []
            stack.callback(record.lock.release)
            if record.epoch != self._epoch:
                self._epoch, self._drawn_end, self._spectrum_end = record.epoch, -1.0, -1.0
                self._seen = dict.fromkeys(self._seen, 0)
            scope, motion = record.scope, record.motion
            if scope is None:
                return []
            channel = view["spectrum"]
            # also when the picture has been drawn already: a paused player was moved soon after the last spectrum
            due = channel and scope.end_s != self._spectrum_end and now - self._spectrum_at >= SPECTRUM_S
            if scope.end_s == self._drawn_end and not due:
                return []
            trace = self._trace(scope)
            if trace is None:
                return []
            self._drawn_end = scope.end_s
            frames = []
            for kind, rows in (
                (FrameKind.MOTION, motion.states),
                (FrameKind.IMPACTS, motion.impacts),
                (FrameKind.DETECTED, motion.detected),
            ):
                if rows.count > self._seen[kind]:
                    frames.append(protocol.rows_frame(kind, self._epoch, rows.since(self._seen[kind])))
                self._seen[kind] = rows.count
            if due:
                self._spectrum_at, self._spectrum_end = now, scope.end_s
                number = CHANNELS.index(channel)
                found = spectrum(scope.stretch(SPECTRUM_SPAN_S)[number], scope.rate_hz, view["top"])
                frames.append(protocol.spectrum_frame(self._epoch, *found, number))
            other = self._trace(source.other) if source.other is not None else None
            if other is not None:
                frames.append(protocol.trace_frame(FrameKind.TRACE_B, self._epoch, other, source.now_s))
            self._frame += 1
            frames.append(protocol.trace_frame(FrameKind.TRACE, self._frame, trace, source.now_s))
        return frames

    def _trace(self, scope: Scope) -> Trace | None:
        view = self._view
        return scope.window(view["span"], int(view["columns"]), trigger=view["trigger"])


class _Counting(logging.Handler):
    """Log handler that only counts the messages of aiohttp, so that clients with invalid requests cannot fill the log.

    Args:
        counts: counts by reason, which the handler increases (`Server.refused`).
    """

    def __init__(self, counts: Counter[str]) -> None:
        super().__init__()
        self._counts = counts

    def emit(self, record: logging.LogRecord) -> None:
        """Count a log message: an error as "malformed HTTP", any other as "connections"."""
        self._counts["malformed HTTP" if record.levelno >= logging.ERROR else "connections"] += 1


class Server:
    """Web server of the page for one source, with its own event loop in its own thread.

    It runs from `start`, or the beginning of a `with` block, until `close`.

    Args:
        source: live rig or recorded runs for pages that do not request runs themselves.
        host: address of this machine at which the page is served.
        port: TCP port; 0 means any free one.
        token: secret that the address of the page must contain; empty means a new one.
        runs: directory with recorded runs that a page may play; None means none.

    Attributes:
        token: secret in the address of the page.
        port: TCP port of the running server.

    Raises:
        ImpactRigError: the port is invalid, or uPlot is not installed.
    """

    def __init__(
        self, source: Source, host: str = LOOPBACK, port: int = PORT, token: str = "", runs: Path | None = None
    ) -> None:
        check_port(port)
        self._source, self._runs = source, runs
        self._host, self._wanted_port = host, port
        self._is_local = host == LOOPBACK
        self.token = token or secrets.token_hex(24)
        self.port = 0
        self.refused: Counter[str] = Counter()
        """Number of rejections by reason: token, origin, host, binary, malformed, too many pages, and others."""
        self._logger = logging.Logger("impact_rig_lab.server")
        self._logger.addHandler(_Counting(self.refused))
        self._joining: set[asyncio.Task[None]] = set()
        self._transports: list[asyncio.Transport] = []
        self._unserved: set[Any] = set()
        self._folders = {"": STATIC, "uplot": plotter_files()}
        self._sockets: dict[web.WebSocketResponse, Source] = {}
        self._pages = 0  # number of pages that are open or about to open: a player needs a while to find its run
        self._thread = threading.Thread(target=self._run, name="lab-server", daemon=True)
        self._ready = threading.Event()
        self._failure: OSError | ValueError | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._end: asyncio.Event | None = None

    @property
    def address(self) -> str:
        """Address (URL) with the token, to open in a browser once the server runs; its host is that of the server."""
        return f"http://{self._name}:{self.port}/?token={self.token}"

    @property
    def _name(self) -> str:
        return f"[{self._host}]" if ":" in self._host else self._host  # IPv6

    def start(self) -> None:
        """Start the server in its thread; when this returns, the page can be opened.

        Raises:
            ImpactRigError: the address or port cannot be used, for example because another program uses it.
        """
        self._thread.start()
        self._ready.wait()
        if self._failure is not None:
            self._thread.join()
            reason = "invalid host name"
            if isinstance(self._failure, OSError):
                reason = self._failure.strerror or str(self._failure)
            raise ImpactRigError(
                f"cannot serve {self._host}:{self._wanted_port}: {reason}; choose another --port or --host"
            ) from self._failure

    def close(self) -> None:
        """Disconnect all open pages, and stop the server; without effect if it is not running."""
        loop, end = self._loop, self._end
        if loop is not None and end is not None and self._thread.is_alive():
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(end.set)
            self._thread.join()

    def __enter__(self) -> Server:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        lower_priority()
        with asyncio.Runner() as runner:
            runner.run(self._serve())

    async def _serve(self) -> None:
        loop = self._loop = asyncio.get_running_loop()
        self._end = asyncio.Event()
        # for example, no descriptors left
        loop.set_exception_handler(lambda _loop, _context: self._count("connections"))
        runner = web.AppRunner(
            self._application(), access_log=None, handle_signals=False, shutdown_timeout=2.0, logger=self._logger
        )
        await runner.setup()
        try:
            family = (await loop.getaddrinfo(self._host, self._wanted_port, type=socket.SOCK_STREAM))[0][0]
            listener = socket.create_server((self._host, self._wanted_port), family=family)
            listener.setblocking(False)
            address, self.port = listener.getsockname()[:2]
            self._is_local = ipaddress.ip_address(address).is_loopback  # under any name
        except (OSError, ValueError) as error:  # ValueError: a part is empty or too long, or a null character
            self._failure = error
            await runner.cleanup()
            return
        finally:
            self._ready.set()
        assert runner.server is not None
        self._listen(listener, runner.server)
        await self._end.wait()
        loop.remove_reader(listener)
        listener.close()
        await asyncio.gather(*self._joining)
        for page in list(self._sockets):
            await page.close(code=1001, message=b"the lab has ended")
        await runner.cleanup()
        for transport in self._transports:  # a transport with unsent data would outlive the loop
            transport.abort()
        await asyncio.sleep(0)

    def _listen(self, listener: socket.socket, server: web.Server) -> None:
        assert self._loop is not None
        if listener.fileno() >= 0:
            self._loop.add_reader(listener, self._accept, listener, server)

    def _accept(self, listener: socket.socket, server: web.Server) -> None:
        """Accept a waiting connection of a client; close it at once if there are `MOST_CONNECTIONS` already.

        `sock_accept` is not used, because a cancellation can lose the connection that it has just accepted.
        """
        assert self._loop is not None
        try:
            connection, _ = listener.accept()
        except BlockingIOError:  # the client has disconnected
            return
        except OSError:  # for example, no descriptors left
            self._count("connections")
            self._loop.remove_reader(listener)
            self._loop.call_later(NO_DESCRIPTOR_S, self._listen, listener, server)
            return
        self._transports = [one for one in self._transports if one.get_extra_info("socket").fileno() >= 0]
        if len(self._transports) + len(self._joining) >= MOST_CONNECTIONS:
            self._count("too many connections")
            connection.close()
            return
        joining = self._loop.create_task(self._connect(connection, server))
        self._joining.add(joining)
        joining.add_done_callback(self._joining.discard)

    async def _connect(self, connection: socket.socket, server: web.Server) -> None:
        assert self._loop is not None
        transport, handler = await self._loop.connect_accepted_socket(server, connection)
        self._transports.append(transport)
        self._unserved.add(handler)
        self._loop.call_later(HEADERS_S, self._close_unless_served, handler)

    def _close_unless_served(self, handler: Any) -> None:
        if handler in self._unserved and handler.transport is not None:
            self._count("incomplete requests")
            handler.transport.close()
        self._unserved.discard(handler)

    def _count(self, reason: str) -> None:
        self.refused[reason] += 1

    def _application(self) -> web.Application:
        application = web.Application(middlewares=[self._guard], client_max_size=protocol.LONGEST_REQUEST)
        application.router.add_get("/", self._page)
        application.router.add_get("/socket", self._socket)
        application.router.add_get("/runs", self._list_runs)
        application.router.add_get("/static/{name:[a-zA-Z_.-]+}", self._file(""))
        application.router.add_get("/uplot/{name:[a-zA-Z_.-]+}", self._file("uplot"))
        return application

    # Access control

    def _refuse(self, reason: str, text: str, status: int = 403) -> web.Response:
        self._count(reason)
        return web.Response(status=status, text=text, headers=HEADERS)

    def _hosts(self) -> set[str]:
        names = {self._name.lower(), "localhost", LOOPBACK} if self._is_local else {self._name.lower()}
        known = {f"{name}:{self.port}" for name in names}
        return known | names if self.port == HTTP_PORT else known  # browsers omit the default port

    @web.middleware
    async def _guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Pass a request to its handler, unless it comes from another web site (middleware of the application).

        Requests with the origin of another page are rejected. If the lab is served only to this machine, requests with
        a wrong host name are rejected as well (DNS rebinding).
        """
        self._unserved.discard(request.protocol)
        response: web.StreamResponse | None = self._turned_away(request)
        try:
            if response is None:
                response = await handler(request)
        except web.HTTPException as error:  # raised if there is no such page
            self._close_after(error)
            raise
        if not isinstance(response, web.WebSocketResponse):
            self._close_after(response)
        return response

    def _turned_away(self, request: web.Request) -> web.Response | None:
        if self._is_local and request.host.lower() not in self._hosts():
            return self._refuse(
                "host", "wrong host name for this lab: open the address that was printed where the lab was started"
            )
        origin = request.headers.get("Origin")
        allowed = {f"http://{host}" for host in self._hosts()} | {f"http://{request.host}"}
        if origin is not None and origin not in allowed:
            return self._refuse("origin", "pages of other web sites may not access this lab")
        return None

    def _close_after(self, response: web.StreamResponse) -> None:
        response.headers.update(HEADERS)
        response.force_close()  # one request per connection: no connection is kept open

    def _known(self, request: web.Request) -> bool:
        return hmac.compare_digest(request.query.get("token", "").encode(), self.token.encode())

    # Resources

    async def _page(self, request: web.Request) -> web.Response:
        if not self._known(request):
            return self._refuse(
                "token", "The address of a lab ends with ?token=…: copy it from the terminal where the lab was started."
            )
        return self._answer(STATIC / "index.html")

    def _file(self, folder: str) -> Handler:
        known = {path.name: path for path in self._folders[folder].iterdir() if path.suffix in TYPES}

        async def serve(request: web.Request) -> web.Response:
            path = known.get(request.match_info["name"])
            return web.Response(status=404) if path is None else self._answer(path)

        return serve

    def _answer(self, path: Path) -> web.Response:
        return web.Response(body=path.read_bytes(), content_type=TYPES[path.suffix], charset="utf-8")

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        if not self._known(request):
            return self._refuse("token", _WRONG_ADDRESS)
        if request.headers.get("Origin") is None:
            return self._refuse(
                "origin", "the request lacks the header Origin, by which a browser states from which site its page is"
            )
        if self._pages >= MOST_PAGES:
            return self._refuse("too many pages", f"{MOST_PAGES} pages of this lab are open already: close one", 503)
        self._pages += 1
        try:
            return await self._serve_page(request)
        finally:
            self._pages -= 1

    async def _serve_page(self, request: web.Request) -> web.StreamResponse:
        try:
            names = request.query.getall("run", [])
            source = await asyncio.to_thread(self._player, names) if names else self._source
        except ImpactRigError as error:
            return self._refuse("run", str(error), 404)
        page = web.WebSocketResponse(max_msg_size=protocol.LONGEST_REQUEST, heartbeat=20.0, compress=False)
        try:
            await page.prepare(request)  # raises if the request is not for a WebSocket, or the page has disconnected
            self._sockets[page] = source
            self._watched(source)
            await PageSession(page, source, self.refused).run()
        finally:
            self._sockets.pop(page, None)
            self._watched(source)
            if isinstance(source, PlaybackSource) and source is not self._source:
                await asyncio.to_thread(source.close)
        if page.close_code == 1009:
            self._count("oversized")
        return page

    def _watched(self, source: Source) -> None:
        source.watchers = sum(one is source for one in self._sockets.values())

    # Recorded runs

    def runs(self) -> list[Path]:
        """Return the recorded runs that a page may play: directories with MCAP files in the folder of runs.

        The newest `MOST_RUNS` directories are returned, the last changed one first. The list is empty if the server has
        no folder of runs.
        """
        if self._runs is None:
            return []
        found: dict[Path, float] = {}
        with contextlib.suppress(OSError):
            for path in self._runs.iterdir():
                with contextlib.suppress(OSError):
                    if path.is_dir() and any(path.glob("*.mcap")):
                        found[path] = path.stat().st_mtime
        return sorted(found, key=lambda path: -found[path])[:MOST_RUNS]

    async def _list_runs(self, request: web.Request) -> web.Response:
        if not self._known(request):
            return self._refuse("token", _WRONG_ADDRESS)
        found = await asyncio.to_thread(self._described_runs)
        return web.json_response(found)

    def _described_runs(self) -> list[dict[str, Any]]:
        found = []
        for path in self.runs():
            with contextlib.suppress(OSError):  # a run that is being deleted, or a dangling link
                size = sum(one.stat().st_size for one in path.glob("*.mcap"))
                found.append({"name": path.name, "megabytes": round(size / 1e6, 1)})
        return found

    def _player(self, names: Sequence[str]) -> Source:
        """Return a new, started player of recorded runs for one page; the caller must close it.

        Args:
            names: names of one or two runs.

        Raises:
            ImpactRigError: a name is not that of a run in `runs`, there are more than two names, or a run cannot be
                shown.
        """
        known = {path.name: path for path in self.runs()}
        unknown = [name for name in names if name not in known]
        if unknown:
            raise ImpactRigError(
                f"there is no recorded run {unknown[0]!r} among the newest {MOST_RUNS} in the directory whose "
                "runs this lab lists; to play another one, start impact-rig lab with its path"
            )
        if len(names) > MOST_AT_ONCE:
            raise ImpactRigError(f"at most {MOST_AT_ONCE} runs can be shown at once, got {len(names)}")
        source = PlaybackSource([known[name] for name in names])
        source.start()
        return source
