# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The web server: the page and its one WebSocket, for whoever has the token, on the loopback unless told otherwise.

Nothing is fetched from elsewhere, and the page may fetch nothing from elsewhere: the content security policy says so.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import importlib.util
import os
import secrets
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path

from aiohttp import web

from impact_rig.errors import ImpactRigError
from impact_rig.lab import protocol
from impact_rig.lab.session import Session
from impact_rig.lab.source import Source, be_gentle

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]
STATIC = Path(__file__).parent / "static"
LOOPBACK = "127.0.0.1"
PORT = 8765
MOST_PAGES = 16
TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
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


def plotter_files() -> Path:
    """Return the folder with uPlot, of the package `uplot-python`; nothing of that package is imported.

    Raises:
        ImpactRigError: it is not installed.
    """
    found = importlib.util.find_spec("uplot")
    if found is None or found.origin is None:
        raise ImpactRigError("the lab needs uPlot: pip install uplot-python")
    return Path(found.origin).parent / "static"


def kept_token() -> str:
    """Return this user's token, made once: an open page finds its lab again after it was started anew."""
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    path = Path(base) / "impact_rig" / "lab_token"
    with contextlib.suppress(OSError, UnicodeDecodeError):
        found = path.read_text(encoding="ascii").strip()
        if len(found) >= 32 and found.isalnum() and path.stat().st_mode & 0o077 == 0:
            return found
    token = secrets.token_hex(24)
    with contextlib.suppress(OSError):  # then it holds for this start only
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "w", encoding="ascii") as file:
            file.write(token)
    return token


class Server:
    """Serves a source, in an event loop and a thread of its own.

    Args:
        source: what is shown.
        host: address to bind.
        port: 0: any that is free.
        token: that the address of the page must carry.
    """

    def __init__(self, source: Source, host: str = LOOPBACK, port: int = PORT, token: str = "") -> None:
        self._source = source
        self._host, self._wanted_port = host, port
        self.token = token or secrets.token_hex(24)
        self.port = 0
        self.refused: dict[str, int] = {}
        """What was refused so far, by reason: token, origin, host, binary, malformed, too many pages."""
        self._folders = {"": STATIC, "uplot": plotter_files()}
        self._sockets: set[web.WebSocketResponse] = set()
        self._thread = threading.Thread(target=self._run, name="lab-server", daemon=True)
        self._ready = threading.Event()
        self._failure: OSError | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._end: asyncio.Event | None = None

    @property
    def address(self) -> str:
        """Return the address of the page."""
        return f"http://{self._host}:{self.port}/?token={self.token}"

    def start(self) -> None:
        """Begin to serve.

        Raises:
            ImpactRigError: the address cannot be bound.
        """
        self._thread.start()
        self._ready.wait()
        if self._failure is not None:
            self._thread.join()
            reason = self._failure.strerror or str(self._failure)
            raise ImpactRigError(
                f"{self._host}:{self._wanted_port} cannot be served: {reason}; choose another --port"
            ) from self._failure

    def close(self) -> None:
        """Close every page and end."""
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
        be_gentle()
        with asyncio.Runner() as runner:
            runner.run(self._serve())

    async def _serve(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        runner = web.AppRunner(self._application(), access_log=None, handle_signals=False, shutdown_timeout=2.0)
        await runner.setup()
        try:
            site = web.TCPSite(runner, self._host, self._wanted_port)
            await site.start()
            self.port = runner.addresses[0][1]
        except OSError as error:
            self._failure = error
            await runner.cleanup()
            return
        finally:
            self._ready.set()
        await self._end.wait()
        for socket in list(self._sockets):
            await socket.close(code=1001, message=b"the lab has ended")
        await runner.cleanup()

    def _application(self) -> web.Application:
        application = web.Application(middlewares=[self._guard], client_max_size=protocol.LONGEST_REQUEST)
        application.router.add_get("/", self._page)
        application.router.add_get("/socket", self._socket)
        application.router.add_get("/static/{name:[a-zA-Z_.-]+}", self._file(""))
        application.router.add_get("/uplot/{name:[a-zA-Z_.-]+}", self._file("uplot"))
        return application

    # Who may come in

    def _refuse(self, reason: str, text: str, status: int = 403) -> web.Response:
        self.refused[reason] = self.refused.get(reason, 0) + 1
        return web.Response(status=status, text=text, headers=HEADERS)

    def _hosts(self) -> set[str]:
        names = {self._host, "localhost", LOOPBACK} if self._host == LOOPBACK else {self._host}
        return {f"{name}:{self.port}" for name in names}

    @web.middleware
    async def _guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse who asks for another host (DNS rebinding) or comes from another page."""
        local = self._host == LOOPBACK
        if local and request.host not in self._hosts():
            return self._refuse("host", "this lab has another name")
        origin = request.headers.get("Origin")
        allowed = {f"http://{host}" for host in self._hosts()} | {f"http://{request.host}"}
        if origin is not None and origin not in allowed:
            return self._refuse("origin", "pages of others may not look into this lab")
        response = await handler(request)
        if isinstance(response, web.WebSocketResponse):
            return response
        response.headers.update(HEADERS)
        return response

    def _known(self, request: web.Request) -> bool:
        return hmac.compare_digest(request.query.get("token", "").encode(), self.token.encode())

    # What there is

    async def _page(self, request: web.Request) -> web.Response:
        if not self._known(request):
            return self._refuse("token", "The address of a lab ends with ?token=…: take it from where it was started.")
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
            return self._refuse("token", "the token is missing or wrong")
        if request.headers.get("Origin") is None:
            return self._refuse("origin", "a page says where it comes from")
        if len(self._sockets) >= MOST_PAGES:
            return self._refuse("too many pages", f"{MOST_PAGES} pages are open already", 503)
        socket = web.WebSocketResponse(max_msg_size=protocol.LONGEST_REQUEST, heartbeat=20.0, compress=False)
        await socket.prepare(request)
        self._sockets.add(socket)
        self._source.watched(len(self._sockets))
        try:
            await Session(socket, self._source, self.refused).run()
        finally:
            self._sockets.discard(socket)
            self._source.watched(len(self._sockets))
        if socket.close_code == 1009:
            self.refused["oversized"] = self.refused.get("oversized", 0) + 1
        return socket
