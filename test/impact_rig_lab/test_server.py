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
"""Access to the server: loopback, token, origin, sizes; and one picture at a time."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from kits import loops
from kits.browser import Page
from kits.lab import FakeSource, scans

from impact_rig.errors import ImpactRigError
from impact_rig_lab import protocol
from impact_rig_lab.protocol import FrameKind
from impact_rig_lab.server import LOOPBACK, MOST_CONNECTIONS, MOST_UNDRAWN, POLICY, Server, kept_token
from impact_rig_lab.state import choices

TIMEOUT = aiohttp.ClientTimeout(30)


@pytest.fixture
def source() -> FakeSource:
    return FakeSource()


@pytest.fixture
def server(source: FakeSource) -> Iterator[Server]:
    with Server(source, port=0) as found:
        yield found


def get(server: Server, path: str, **headers: str) -> tuple[int, dict[str, str], str]:
    async def ask() -> tuple[int, dict[str, str], str]:
        async with (
            aiohttp.ClientSession(timeout=TIMEOUT) as session,
            session.get(f"http://{LOOPBACK}:{server.port}{path}", headers=headers) as answer,
        ):
            return answer.status, dict(answer.headers), await answer.text()

    return loops.run(ask())


async def connect(session: aiohttp.ClientSession, server: Server, **changes: Any) -> aiohttp.ClientWebSocketResponse:
    base = f"http://{LOOPBACK}:{server.port}"
    headers = {"Origin": changes.get("origin", base)} if changes.get("origin", base) else {}
    token = changes.get("token", server.token)
    return await session.ws_connect(f"{base}/socket?token={token}", headers=headers, max_msg_size=0)


def refused_status(server: Server, **changes: Any) -> int:
    async def ask() -> int:
        async with aiohttp.ClientSession(timeout=TIMEOUT) as session:
            with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
                await connect(session, server, **changes)
            return caught.value.status

    return loops.run(ask())


def test_the_server_listens_only_on_the_loopback(server: Server) -> None:
    assert server._host == LOOPBACK
    with socket.socket() as other:
        other.settimeout(2.0)
        assert other.connect_ex(("127.0.0.2", server.port)) != 0


def test_the_page_needs_the_token_and_has_a_strict_policy(server: Server) -> None:
    status, headers, text = get(server, f"/?token={server.token}")
    assert status == 200
    assert "<!doctype html>" in text
    assert headers["Content-Security-Policy"] == POLICY
    assert "unsafe" not in POLICY
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert get(server, "/")[0] == get(server, "/?token=guess")[0] == 403
    assert dict(server.refused) == {"token": 2}
    assert server.token not in text


@pytest.mark.parametrize(
    ("request_line", "host", "status"),
    [
        ("GET /nothing", None, 404),
        ("POST /", None, 405),
        ("GET /", "evil.example", 403),
        ("GET /socket?token={token}", None, 400),  # asks for no WebSocket
    ],
)
def test_rejected_connections_are_closed(server: Server, request_line: str, host: str | None, status: int) -> None:
    """If refused connections stayed open for a minute, sixty-four of them from any client would block every page."""
    here = f"{LOOPBACK}:{server.port}"
    lines = [f"{request_line.format(token=server.token)} HTTP/1.1", f"Host: {host or here}"]
    lines += [f"Origin: http://{here}"] if host is None else []
    with socket.create_connection((LOOPBACK, server.port), timeout=10.0) as connection:
        connection.sendall("\r\n".join([*lines, "", ""]).encode())
        answer = b"".join(iter(lambda: connection.recv(4096), b""))  # to its end: a connection held open times out
    assert answer.startswith(f"HTTP/1.1 {status} ".encode())
    assert POLICY.encode() in answer


def test_only_files_of_the_package_are_served(server: Server) -> None:
    assert get(server, "/static/main.js")[0] == 200
    assert get(server, "/uplot/uPlot.iife.js")[0] == 200
    for path in (
        "/static/..%2fserver.py",
        "/static/../server.py",
        "/static/server.py",
        "/uplot/__init__.py",
        "/etc/passwd",
    ):
        assert get(server, path)[0] == 404, path


def test_a_foreign_host_name_or_origin_is_rejected(server: Server) -> None:
    """A foreign page, and a foreign name that resolves to this machine (DNS rebinding)."""
    path = f"/?token={server.token}"
    assert get(server, path, Host="evil.example")[0] == 403
    assert get(server, path, Origin="http://evil.example")[0] == 403
    assert refused_status(server, origin="http://evil.example") == 403
    assert refused_status(server, origin="null") == 403
    assert refused_status(server, origin="") == 403
    assert refused_status(server, token="") == refused_status(server, token="guess") == 403
    assert dict(server.refused) == {"host": 1, "origin": 4, "token": 2}


def test_invalid_requests_are_rejected_and_counted_and_end_the_connection(server: Server, source: FakeSource) -> None:
    async def talk() -> tuple[list[str], int | None]:
        async with aiohttp.ClientSession(timeout=TIMEOUT) as session:
            page = await connect(session, server)
            answers = []
            for request in ("{", "[]", '{"do":"rm"}', '{"do":"frequency","value":"9"}', '{"do":"stop","more":1}'):
                await page.send_str(request)
            while len(answers) < 5:
                message = await page.receive()
                if message.data[0] == FrameKind.REPLY:
                    answers.append(json.loads(message.data[8:])["text"])
            await page.send_bytes(b"\x00")
            await page.send_str("x" * (protocol.LONGEST_REQUEST + 1))
            while (message := await page.receive()).type is aiohttp.WSMsgType.BINARY:
                pass
            return answers, page.close_code

    answers, code = loops.run(talk())
    assert [answer.split()[0] for answer in answers] == ["a", "a", "there", "frequency", "stop"]
    assert code == 1009
    assert source.asked == []
    assert server.refused["malformed"] == 5
    assert server.refused["binary"] == 1


def test_a_client_that_keeps_sending_invalid_messages_is_disconnected(server: Server) -> None:
    async def talk() -> int | None:
        async with aiohttp.ClientSession(timeout=TIMEOUT) as session:
            page = await connect(session, server)
            for _ in range(30):
                await page.send_str("nonsense")
            while (await page.receive()).type is aiohttp.WSMsgType.BINARY:
                pass
            return page.close_code

    assert loops.run(talk()) == 1008


@pytest.mark.heavy
def test_a_stalled_page_receives_two_pictures_and_an_active_one_all(server: Server, source: FakeSource) -> None:
    """The third picture waits until the first is drawn; the state, which is small, is still sent."""

    async def talk() -> tuple[int, int]:
        async with aiohttp.ClientSession(timeout=TIMEOUT) as session:
            stalled, quick = await connect(session, server), await connect(session, server)
            drawn = 0
            for number in range(8):
                with source.record.lock:
                    source.scope.add(scans(number * 100, 100, laser=float(number)), 0)
                while True:
                    data = (await quick.receive()).data
                    if data[0] == FrameKind.TRACE:
                        drawn += 1
                        await quick.send_str(json.dumps({"do": "ack", "frame": struct.unpack_from("<I", data, 4)[0]}))
                        break
            pictures = 0
            while True:
                try:
                    data = (await asyncio.wait_for(stalled.receive(), 0.3)).data
                except TimeoutError:
                    return pictures, drawn
                pictures += data[0] == FrameKind.TRACE

    pictures, drawn = loops.run(talk())
    assert drawn == 8
    assert pictures == MOST_UNDRAWN


def test_the_current_state_is_sent_before_the_answer(server: Server, source: FakeSource) -> None:
    """A page that takes the answer as the end of its wait must not receive an old value after it."""

    def ask(request: protocol.Request, answer: Any) -> None:
        source.snapshot.put(applied={"frequency": request.values["value"]})
        answer(True, "")

    source.ask = ask  # type: ignore[method-assign]

    async def talk() -> list[int]:
        async with aiohttp.ClientSession(timeout=TIMEOUT) as session:
            page = await connect(session, server)
            kinds = []
            await page.send_str('{"id":5,"do":"frequency","value":9.3}')
            while FrameKind.REPLY not in kinds:
                data = (await page.receive()).data
                if data[0] != FrameKind.STATE or b"9.3" in data:
                    kinds.append(data[0])
            return kinds

    assert loops.run(talk()) == [FrameKind.STATE, FrameKind.REPLY]


def test_a_stop_is_passed_on_while_a_jump_fills_the_buffers_of_a_run(
    server: Server, source: FakeSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All pages share a loop: one that waits for the scans of its run must not delay the STOP of the live page."""
    source.scope.add(scans(0, 600), 0)
    asked = threading.Event()
    monkeypatch.setattr(source, "ask", lambda request, answer: asked.set())

    async def talk() -> bool:
        async with aiohttp.ClientSession(timeout=TIMEOUT) as session:
            page = await connect(session, server)
            await page.receive()
            await page.send_str('{"id":5,"do":"stop"}')
            return await asyncio.to_thread(asked.wait, 10.0)

    with source.record.lock:
        assert loops.run(talk())


def test_a_drive_in_volts_is_shown_with_its_unit(
    server: Server, source: FakeSource, open_page: Callable[..., Page]
) -> None:
    page = open_page(server.address)
    shown = "document.querySelector('.knob:has(#knob-current) .unit').textContent"
    for kind, unit in (("voltage", "V"), ("prescribed", "m"), ("current", "A")):
        source.snapshot.put(choices=choices(), knobs={"drive.kind": kind})
        page.wait(f"{shown} === '{unit}'", f"the unit {unit}")


def test_open_pages_are_counted(server: Server, source: FakeSource) -> None:
    async def talk() -> None:
        async with aiohttp.ClientSession(timeout=TIMEOUT) as session:
            page = await connect(session, server)
            await page.receive()
            assert source.watchers == 1

    loops.run(talk())


def talk_to(server: Server, data: bytes) -> bytes:
    """Send some bytes, and return what arrives until the server closes the connection."""
    with socket.create_connection((LOOPBACK, server.port), timeout=30.0) as connection:
        connection.sendall(data)
        found = b""
        with contextlib.suppress(ConnectionError):
            while part := connection.recv(4096):
                found += part
    return found


@pytest.mark.heavy
def test_an_endless_request_is_closed_and_no_request_prints_output(
    server: Server, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("impact_rig_lab.server.HEADERS_S", 0.2)
    assert talk_to(server, b"GET / HTTP/1.1\r\nHost: here\r\n") == b""
    assert server.refused["incomplete requests"] == 1
    for nonsense in (b"\x16\x03\x01\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n", b"GET /\xff HTTP/1.1\r\n\r\n", b"\0" * 20000):
        talk_to(server, nonsense)
    assert get(server, f"/?token={server.token}")[0] == 200
    assert capfd.readouterr() == ("", "")


def test_connections_beyond_the_limit_are_rejected_and_the_page_continues(server: Server) -> None:
    """Each connection needs a descriptor: without a limit, a process without any left could not accept its operator."""

    async def talk() -> list[bytes]:
        async with aiohttp.ClientSession(timeout=TIMEOUT) as session:
            page = await connect(session, server)
            held = [await asyncio.open_connection(LOOPBACK, server.port) for _ in range(MOST_CONNECTIONS + 20)]
            await page.send_str('{"id":1,"do":"stop"}')
            while True:
                message = await page.receive()
                if message.data[0] == FrameKind.REPLY:
                    break
            reads = [asyncio.create_task(reader.read()) for reader, _writer in held]
            ended = iter(asyncio.as_completed(reads, timeout=5.0))  # shorter than the timeout of silent clients
            closed = []
            for _ in range(20):  # whichever: not every kernel hands connections over in the order they were opened in
                with contextlib.suppress(ConnectionError):
                    closed.append(await next(ended))
            for read, (_, writer) in zip(reads, held, strict=True):
                read.cancel()
                writer.close()
            return closed

    assert set(loops.run(talk())) <= {b""}
    assert server.refused["too many connections"] >= 20


def test_a_control_without_a_reported_value_shows_none(
    server: Server, source: FakeSource, open_page: Callable[..., Page]
) -> None:
    """A slider always has a position: the middle by default, or the value of the previous rig."""
    page = open_page(server.address)
    slider = "document.querySelector('.knob:has(#knob-gap) input[type=range]')"
    seen = f"[document.getElementById('knob-gap').value, getComputedStyle({slider}).visibility].join()"
    page.wait(f"{seen} === ',hidden'", "no gap")
    source.snapshot.put(knobs={"sphere.present": True, "barriers.gap_m": 0.004})
    page.wait(f"{seen} === '4,visible'", "the new gap")
    source.snapshot.put(knobs=None)
    page.wait(f"{seen} === ',hidden'", "no gap of another rig")


def test_a_restarted_lab_begins_a_new_record(open_page: Callable[..., Page]) -> None:
    """The new lab's first record has the number of the old one, but impacts of the old rig must not stay."""

    def found(second: int) -> FakeSource:
        made = FakeSource()
        made.scope.add(scans(second * 1000, 1000), 0)
        made.record.motion.detected.add((second + 0.9, 1.0, 1.0))
        return made

    def marked(second: int) -> str:
        return f"JSON.stringify(lab.scope.impacts[1]) === '[{second + 0.9}]'"

    with Server(found(500), port=0) as before:
        page = open_page(before.address)
        page.wait(marked(500), "the impact")
        page.expected = "ERR_CONNECTION_REFUSED"
    with Server(found(1), port=before.port, token=before.token):
        page.wait("lab.link.connected && lab.scope.trace.begin < 100", "the new record")
        assert page.js(marked(1)), page.js("JSON.stringify(lab.scope.impacts)")
        page.js("lab.link.socket.onclose = null")


def test_runs_are_listed_and_played_next_to_the_live_view(
    source: FakeSource, sample: Path, open_page: Callable[..., Page]
) -> None:
    (sample.parent / "no_run").mkdir(exist_ok=True)
    with Server(source, port=0, runs=sample.parent) as server:
        token = f"token={server.token}"
        assert get(server, "/runs")[0] == 403
        (found,) = (one for one in json.loads(get(server, f"/runs?{token}")[2]) if one["name"] == sample.name)
        assert found["megabytes"] > 0

        async def talk() -> dict[str, Any]:
            async with aiohttp.ClientSession(timeout=TIMEOUT) as session:
                page = await connect(session, server, token=f"{server.token}&run={sample.name}")
                while (data := (await page.receive()).data)[0] != FrameKind.STATE:
                    pass
                return json.loads(data[8:])

        assert loops.run(talk())["mode"] == "playback"
        page = open_page(server.address)
        page.js("document.getElementById('recorded').open = true")
        page.wait(f"document.getElementById('run-list').textContent.includes('{sample.name} (')", "the list")
        assert page.js("document.getElementById('run-play').disabled")
        page.click(f"#run-list input[value='{sample.name}']")
        page.wait("!document.getElementById('run-play').disabled", "that it can be played")
        page.js("lab.link.socket.onclose = null")
        assert refused_status(server, token=f"{server.token}&run=../{sample.name}") == 404
        assert refused_status(server, token=f"{server.token}&run=no_run") == 404


def test_an_unreadable_run_does_not_hide_the_others(source: FakeSource, tmp_path: Path) -> None:
    """A dangling link, or a run that is being removed, must not prevent the list of the other runs."""
    for name in ("gone", "whole"):
        (tmp_path / name).mkdir()
    (tmp_path / "gone" / "run.mcap").symlink_to(tmp_path / "nowhere.mcap")
    (tmp_path / "whole" / "run.mcap").write_bytes(b"x" * 200_000)
    with Server(source, port=0, runs=tmp_path) as server:
        status, _, text = get(server, f"/runs?token={server.token}")
    assert status == 200
    assert json.loads(text) == [{"name": "whole", "megabytes": 0.2}]


def test_the_address_of_an_ipv6_lab_is_valid(source: FakeSource) -> None:
    """Without brackets around it, no browser could open the address."""
    with Server(source, "::1", 0) as server:
        assert server.address.startswith(f"http://[::1]:{server.port}/?token=")


@pytest.mark.parametrize("host", [LOOPBACK, "localhost", "127.0.0.2", "::1"])
def test_a_lab_on_this_machine_accepts_no_other_host_name(source: FakeSource, host: str) -> None:
    """If other names were not checked, a foreign page could let its own name resolve to `localhost`."""
    with Server(source, host, 0) as server:
        own = server.address.removeprefix("http://").partition("/")[0]
        for name, status in ((own, 200), (f"localhost:{server.port}", 200), ("evil.example", 403)):
            lines = [f"GET /?token={server.token} HTTP/1.1", f"Host: {name}", f"Origin: http://{name}", "", ""]
            with socket.create_connection((host, server.port), timeout=10.0) as connection:
                connection.sendall("\r\n".join(lines).encode())
                answer = b"".join(iter(lambda: connection.recv(65536), b""))
            assert answer.startswith(f"HTTP/1.1 {status} ".encode()), (name, answer[:100])


def test_a_host_name_without_a_port_is_accepted_at_port_80(source: FakeSource) -> None:
    """A browser leaves port 80 out of the name; the page must not be refused because of this."""
    server = Server(source)
    server.port = 80
    assert {"127.0.0.1", "localhost", "127.0.0.1:80"} <= server._hosts()
    server.port = 8080
    assert "127.0.0.1" not in server._hosts()


@pytest.mark.parametrize("port", [-1, 65536, 99999])
def test_an_invalid_port_is_rejected(source: FakeSource, port: int) -> None:
    with pytest.raises(ImpactRigError, match=f"a port must be 0 \\(any\\) to 65535, got {port}"):
        Server(source, port=port)


def test_a_port_in_use_is_named(server: Server, source: FakeSource) -> None:
    with pytest.raises(ImpactRigError, match=f"cannot serve {LOOPBACK}:{server.port}"):
        Server(source, port=server.port).start()


def test_a_host_name_that_cannot_be_looked_up_is_rejected(source: FakeSource) -> None:
    server = Server(source, host="a..b", port=0)
    with pytest.raises(ImpactRigError, match=r"cannot serve a\.\.b:0: invalid host name; choose"):
        server.start()
    server.close()


def test_a_server_that_was_never_started_can_be_closed(source: FakeSource) -> None:
    Server(source, port=0).close()


def test_only_this_user_can_read_the_stored_token(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    token = kept_token()
    path = tmp_path / "impact_rig" / "lab_token"
    assert path.stat().st_mode & 0o777 == 0o600
    assert kept_token() == token
    path.chmod(0o644)
    assert kept_token() != token, "one that others could read is not used again"


def test_a_player_ends_with_the_connection_that_requested_it(source: FakeSource, sample: Path) -> None:
    """The player also ends after a request that is not for a WebSocket, with its thread and files."""
    before = set(threading.enumerate())
    with Server(source, port=0, runs=sample.parent) as server:
        path = f"/socket?token={server.token}&run={sample.name}"
        status, _, _ = get(server, path, Origin=f"http://{LOOPBACK}:{server.port}")
        assert status == 400
        players = [one for one in set(threading.enumerate()) - before if one.name == "lab-playback"]
        assert not players
        assert server._pages == 0


def test_pages_that_are_still_opening_count_towards_the_limit(
    source: FakeSource, sample: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pages count while their players search for runs; otherwise, any number of pages could open."""
    release, players = threading.Event(), []

    def player(server: Server, _names: object) -> FakeSource:
        release.wait(20.0)
        players.append(FakeSource())
        return players[-1]

    monkeypatch.setattr("impact_rig_lab.server.MOST_PAGES", 2)
    monkeypatch.setattr(Server, "_player", player)

    async def ask(server: Server) -> list[Any]:
        base = f"http://{LOOPBACK}:{server.port}"
        async with aiohttp.ClientSession(timeout=TIMEOUT) as session:
            address = f"{base}/socket?token={server.token}&run={sample.name}"
            opening = [asyncio.ensure_future(session.ws_connect(address, headers={"Origin": base})) for _ in range(4)]
            await asyncio.wait(opening, timeout=2.0, return_when=asyncio.FIRST_COMPLETED)
            release.set()
            found = await asyncio.gather(*opening, return_exceptions=True)
            return [getattr(one, "status", 101) for one in found]

    with Server(source, port=0, runs=sample.parent) as server:
        assert sorted(loops.run(ask(server))) == [101, 101, 503, 503]
    assert len(players) == 2
