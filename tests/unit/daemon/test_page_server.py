"""What the page's server sends, how it bears damaged requests, and that visitors cannot hold it up."""

import asyncio
import hashlib
import json
import re
from contextlib import suppress
from importlib.resources import files
from typing import Any

import pytest

from cell.errors import CellError
from daemon.web.page_files import page_files
from daemon.web.server import WebServer
from tests.kit.page_rig import PageRig, RecordedStates, http_section, on_page

STATIC = files("daemon.web").joinpath("static")


async def states(rig: PageRig, count: int) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    async with rig.client.get(f"{rig.origin}/api/events") as answer:
        assert answer.status == 200
        async for line in answer.content:
            if line.startswith(b"data: "):
                found.append(json.loads(line[6:]))
                if len(found) == count:
                    break
                rig.engine.change(f"STATE {len(found)}")
    return found


def test_the_state_comes_at_once_and_after_every_change() -> None:
    async def use(subject: PageRig) -> None:
        await subject.login("vera")
        assert [s["status"]["packml"] for s in await states(subject, 3)] == ["IDLE", "STATE 1", "STATE 2"]

    on_page(use)


def test_who_is_not_logged_in_sees_nothing_unless_the_cell_shows_itself() -> None:
    paths = ("/api/events", "/api/live")

    async def closed(subject: PageRig) -> None:
        assert (await subject.get("/api/me"))[1] == {
            "user": None, "role": None, "csrf": None, "look": False, "users": True,
        }  # fmt: skip
        for path in paths:
            assert (await subject.get(path))[0] == 401

    async def shown(subject: PageRig) -> None:
        assert (await subject.get("/api/live"))[0] == 200
        assert len(await states(subject, 1)) == 1

    on_page(closed)
    on_page(shown, look_without_login=True)


def test_a_stream_ends_when_its_login_does() -> None:
    async def use(subject: PageRig) -> None:
        await subject.login("vera")
        async with subject.client.get(f"{subject.origin}/api/events") as answer:
            await answer.content.readline()
            await subject.post("/api/logout")
            rest = await asyncio.wait_for(answer.content.read(), 5.0)
        assert rest.count(b"event: state") <= 1

    on_page(use)


def test_every_answer_keeps_other_sites_out_and_allows_nothing_but_the_pages_own_files() -> None:
    async def use(subject: PageRig) -> None:
        for path in ("/", "/static/app.js", "/static/none", "/api/me", "/api/events", "/none"):
            async with subject.client.get(subject.origin + path) as answer:
                headers = answer.headers
                assert "default-src 'self'" in headers["Content-Security-Policy"], path
                assert "frame-ancestors 'none'" in headers["Content-Security-Policy"], path
                assert headers["X-Content-Type-Options"] == "nosniff"
                assert headers["X-Frame-Options"] == "DENY"
                assert headers["Server"] == "cellward"
                assert headers["Cache-Control"] in ("no-store", "no-cache")
                assert "Access-Control-Allow-Origin" not in headers

    on_page(use)


def test_a_name_that_another_site_points_at_this_computer_is_refused() -> None:
    async def use(subject: PageRig) -> None:
        port = subject.server.address[1]
        for host in ("evil.example", f"evil.example:{port}", "127.0.0.1", f"127.0.0.1:{port + 1}"):
            assert (await subject.get("/", Host=host))[0] == 403, host
        for host in (f"localhost:{port}", f"127.0.0.1:{port}", f"BAY-3.plant:{port}"):
            assert (await subject.get("/", Host=host))[0] == 200, host

    on_page(use, names=["bay-3.plant"])


def test_no_path_reaches_a_file_that_is_not_the_pages() -> None:
    async def use(subject: PageRig) -> None:
        for path in ("..%2fserver.py", "%2e%2e/server.py", "/etc/passwd", "vendor", ".", "app.js%00"):
            assert (await subject.get(f"/static/{path}"))[0] == 404, path

    on_page(use)


def test_a_file_that_the_browser_has_is_not_sent_again() -> None:
    async def use(subject: PageRig) -> None:
        async with subject.client.get(f"{subject.origin}/static/app.js") as answer:
            etag = answer.headers["ETag"]
        assert (await subject.get("/static/app.js", If_None_Match=etag))[0] == 200
        assert (await subject.get("/static/app.js", **{"If-None-Match": etag}))[0] == 304

    on_page(use)


@pytest.mark.parametrize(
    "content",
    [
        b"", b"nothing", b"[]",
        b'"x"', b"{", b"[" * 5000, b'{"a":' * 40 + b"1" + b"}" * 40, b'{"job": 1e999}',
        b'{"job": "\\ud800"}', b'{"job": 5}', b'{"job": "x", "params": []}', b"\xff\xfe",
        b'{"job": "' + b"x" * 70_000 + b'"}',
    ],
)  # fmt: skip
def test_a_damaged_request_is_refused_in_words_and_the_next_one_is_answered(content: bytes) -> None:
    async def use(subject: PageRig) -> None:
        await subject.login("otto")
        status, answer = await subject.post("/api/do/start", content)
        assert (status, answer["error"]["name"]) == (400, "ARGUMENT_INVALID")
        assert subject.engine.asked == []
        assert (await subject.post("/api/do/start", {"job": "laser-check"}))[1] == {"done": {"run_id": 7}}

    on_page(use)


def test_a_defect_behind_the_page_is_answered_with_its_number_and_no_traceback() -> None:
    async def use(subject: PageRig) -> None:
        await subject.login("otto")
        subject.engine.refuse = ZeroDivisionError("division by zero")
        status, answer = await subject.post("/api/do/pause")
        assert (status, answer["error"]["name"]) == (500, "INTERNAL")
        assert "Traceback" not in str(answer)

    on_page(use)


def test_a_connection_that_asks_nothing_is_closed_and_too_many_are_turned_away(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("daemon.web.server.FIRST_REQUEST_S", 0.2)
    monkeypatch.setattr("daemon.web.server.MAX_CONNECTIONS", 3)

    async def use(subject: PageRig) -> None:
        silent = [await asyncio.open_connection(*subject.server.address) for _ in range(3)]
        reader, writer = await asyncio.open_connection(*subject.server.address)
        assert await reader.read() == b""
        for each, _ in silent:
            assert await each.read() == b""
        for _, each in (*silent, (reader, writer)):
            each.close()
            with suppress(ConnectionError):
                await each.wait_closed()
        assert (await subject.get("/"))[0] == 200

    on_page(use)


def test_a_visitor_who_does_not_read_is_dropped_and_others_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("daemon.web.serving.SEND_TIMEOUT_S", 0.2)
    monkeypatch.setattr("daemon.web.feed.PERIOD_S", 0.01)

    async def use(subject: PageRig) -> None:
        subject.engine.status = lambda: {"packml": "x" * 1_000_000}  # type: ignore[method-assign]
        _, writer = await asyncio.open_connection(*subject.server.address, limit=1024)
        host = f"127.0.0.1:{subject.server.address[1]}"
        writer.write(f"GET /api/events HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
        feed = subject.server._feed
        for step in range(1000):
            subject.engine.change(str(step))
            if feed.watching == 0 and feed.number > 5:
                break
            await asyncio.sleep(0.01)
        writer.close()
        with suppress(ConnectionError):
            await writer.wait_closed()
        assert feed.watching == 0
        subject.engine.status = lambda: {"packml": "IDLE"}  # type: ignore[method-assign]
        assert len(await states(subject, 1)) == 1

    on_page(use, look_without_login=True)


def test_vendored_files_are_what_their_licence_and_digest_say() -> None:
    listed = json.loads(STATIC.joinpath("vendor/vendored.json").read_text("utf-8"))
    present = page_files()
    scripts = {name.removeprefix("vendor/") for name in present if re.fullmatch(r"vendor/.*\.(js|css)", name)}
    assert scripts == listed.keys()
    for name, entry in listed.items():
        assert hashlib.sha256(present[f"vendor/{name}"].content).hexdigest() == entry["sha256"]
        assert f"vendor/{entry['text']}" in present
    assert sum(len(present[f"vendor/{name}"].content) for name in scripts) < 150_000


def test_nothing_of_the_page_asks_another_computer() -> None:
    for name, file in page_files().items():
        if not name.startswith("vendor/"):
            found = re.findall(rb"https?://[^\s\"']+", file.content)
            assert set(found) <= {b"http://www.w3.org/2000/svg"}, name


def test_a_newcomer_is_never_given_a_state_from_before_anybody_watched() -> None:
    async def use(subject: PageRig) -> None:
        assert (await states(subject, 1))[0]["status"]["packml"] == "IDLE"
        subject.engine.state = "ABORTED"  # while nobody watches
        assert (await states(subject, 1))[0]["status"]["packml"] == "ABORTED"

    on_page(use, look_without_login=True)


def test_a_port_that_is_taken_is_said_with_the_section_to_change() -> None:
    async def use(subject: PageRig) -> None:
        host, port = subject.server.address
        second = WebServer(
            http_section(bind=f"{host}:{port}"), subject.engine, RecordedStates(subject.engine), None
        )
        with pytest.raises(CellError, match=r"\[http\] bind"):
            await second.start()
        await second.stop()

    on_page(use)


def test_a_browser_that_is_killed_leaves_nothing_and_asks_for_nothing() -> None:
    """Its sockets end in the middle of what is sent to it, without a word; a job's question stays open."""

    async def use(subject: PageRig) -> None:
        await subject.login("otto")
        host, port = subject.server.address
        cookie = "; ".join(f"{c.key}={c.value}" for c in subject.client.cookie_jar)
        request = f"GET /api/events HTTP/1.1\r\nHost: {host}:{port}\r\nCookie: {cookie}\r\n\r\n"
        windows = [await asyncio.open_connection(host, port) for _ in range(3)]
        for reader, writer in windows:
            writer.write(request.encode())
            await asyncio.wait_for(reader.readuntil(b"event: state"), 5.0)
        assert subject.server._feed.watching == 3
        for _, writer in windows:
            writer.transport.abort()
        for number in range(100):
            subject.engine.change(f"STATE {number}")
            if subject.server._feed.watching == 0:
                break
            await asyncio.sleep(0.05)
        assert subject.server._feed.watching == 0
        assert subject.engine.asked == []
        assert len(await states(subject, 1)) == 1, "the next visitor is served"
        assert (await subject.post("/api/do/confirm", {"prompt_id": 7}))[0] == 200
        assert [entry[0] for entry in subject.engine.asked] == ["confirm"]

    on_page(use)
