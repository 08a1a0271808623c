"""The page's server: loopback only, one process, nothing kept of a browser. A browser asks for each picture that it draws.

A browser that stalls asks for nothing, so that nothing waits for it. Reading needs no token; every change does.
"""

from __future__ import annotations

import hmac
import io
import json
import os
import secrets
import socket
import struct
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from functools import cached_property
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from time import monotonic
from typing import Any, Final
from urllib.parse import parse_qs

import msgspec

from hil.errors import HilError, located
from hil.log import plain
from hil.pages.live.about import Window, controllers_of, picture
from hil.pages.live.desk import Desk, Wish
from hil.pages.live.script import script_of

HOST: Final = "127.0.0.1"
MOST_BYTES: Final = 64_000
"""Of a wish: a matrix of some thousand numbers."""
MOST_COLUMNS: Final = 4000
MOST_CONNECTIONS: Final = 32
NICE: Final = 5
TIMEOUT_S: Final = 10.0
"""A connection is closed whose next request is not there, whole, within this time."""
POLICY: Final = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src data:; base-uri 'none'; \
form-action 'none'; frame-ancestors 'none'"
ASSETS: Final = {
    "/": ("hil.pages.live", "live.html", "text/html"),
    "/live.css": ("hil.pages.live", "live.css", "text/css"),
    "/live.js": ("hil.pages.live", "live.js", "text/javascript"),
    "/scopes.js": ("hil.pages.live", "scopes.js", "text/javascript"),
    "/devices.js": ("hil.pages.live", "devices.js", "text/javascript"),
    "/act.js": ("hil.pages.live", "act.js", "text/javascript"),
    "/page.css": ("hil.pages.html", "page.css", "text/css"),
    "/uPlot.css": ("hil.pages.html", "uPlot.min.css", "text/css"),
    "/uPlot.js": ("hil.pages.html", "uPlot.iife.min.js", "text/javascript"),
}
"""Path to package, file below its folder `assets`, and kind."""


class LivePage(ThreadingHTTPServer):
    """Serves the page of a desk until it is closed.

    Args:
        desk: what is watched and changed.
        about: what stays the same: names, fields, presets.
        port: 0 for any that is free.

    Raises:
        HilError: the port is taken.
    """

    block_on_close = False  # a browser that keeps its connection open keeps nothing else open
    request_queue_size = MOST_CONNECTIONS

    def __init__(self, desk: Desk, about: Callable[[], dict[str, Any]], port: int) -> None:
        self.desk, self.about = desk, about
        self.token = secrets.token_urlsafe(18)
        self._once: set[str] = set()
        self.refused = 0
        self.closed = False
        self._free = threading.BoundedSemaphore(MOST_CONNECTIONS)
        self.drawing = threading.Lock()  # one picture at a time: many browsers leave the run and its log as much as one does
        with located(f"--port {port}", OSError, advice="--port 0 takes a free one"):
            super().__init__((HOST, port), Handler)
        self._thread = threading.Thread(target=self.serve_forever, kwargs={"poll_interval": 0.1}, name="live page", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Where a browser finds the page, with the token for changes."""
        return f"http://{HOST}:{self.server_port}/?token={self.token}"

    def url_once(self) -> str:
        """Return a URL that leads to `url` once: for a browser's arguments, which every user of this machine can read."""
        word = secrets.token_urlsafe(18)
        self._once.add(word)
        return f"http://{HOST}:{self.server_port}/once?{word}"

    def take_once(self, word: str) -> bool:
        """Return whether a word leads to `url`; it does so no more."""
        with suppress(KeyError):
            self._once.remove(word)
            return True
        return False

    @cached_property
    def hosts(self) -> tuple[str, ...]:
        """Names by which the page may be asked for: no other site's name leads here."""
        return tuple(f"{name}:{self.server_port}" for name in (HOST, "localhost"))

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection in a thread of its own, or close it where there are too many."""
        if not self._free.acquire(blocking=False):
            self.refused += 1
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a connection to its end, behind whatever keeps time."""
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that went away is no news."""

    def close(self) -> None:
        """Serve nothing more; a connection that is open gets one more answer at most."""
        self.closed = True
        self.shutdown()
        self.server_close()
        self._thread.join()

    def __exit__(self, *_: object) -> None:
        self.close()


class Refused(Exception):
    """A request that is not answered as it wishes."""

    def __init__(self, status: HTTPStatus, message: str) -> None:
        super().__init__(message)
        self.status = status


class Whole(io.RawIOBase):
    """What comes from a browser: a request is there in time, however it drips, or the connection ends.

    Args:
        connection: of the browser.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._connection, self.end = connection, 0.0

    def readable(self) -> bool:
        """It is."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Read what is there; wait for it until the request's time is over."""
        left = self.end - monotonic()
        if left <= 0.0:
            raise TimeoutError
        self._connection.settimeout(left)
        return self._connection.recv_into(buffer)


class Handler(BaseHTTPRequestHandler):
    """One connection of a browser."""

    server: LivePage
    protocol_version = "HTTP/1.1"
    server_version = "hil"
    sys_version = ""

    def setup(self) -> None:
        """Bound the time of a whole request, not of each of its bytes."""
        super().setup()
        self._whole = Whole(self.connection)
        self.rfile = io.BufferedReader(self._whole)

    def handle_one_request(self) -> None:
        """Answer the next request; one that is not there in time ends the connection."""
        self._whole.end = monotonic() + TIMEOUT_S
        super().handle_one_request()

    def log_message(self, format: str, *args: Any) -> None:
        """The terminal is the run's."""

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Refuse what is no request, or too long for one."""
        self.server.refused += 1
        super().send_error(code, message, explain)

    def do_GET(self) -> None:
        """Answer with the page, or with what it shows."""
        self._answer(self._get)

    def do_POST(self) -> None:
        """Take a wish."""
        self._answer(self._post)

    def _answer(self, found: Callable[[], tuple[str, bytes]]) -> None:
        try:
            self._check()
            kind, data = found()
            status = HTTPStatus.OK
        except Refused as error:
            self.server.refused += 1
            self.close_connection = True  # what it still sends is not read
            status, kind, data = error.status, "application/json", json.dumps({"error": str(error)}).encode()
        self.close_connection = self.close_connection or self.server.closed
        if kind.startswith("text/"):
            kind += "; charset=utf-8"
        self.connection.settimeout(TIMEOUT_S)  # one that takes nothing for so long, or has gone, gets no further answer
        self.send_response(status)
        for name, value in (
            ("Content-Type", kind), ("Content-Length", str(len(data))),
            ("Content-Security-Policy", POLICY), ("X-Content-Type-Options", "nosniff"), ("Referrer-Policy", "no-referrer"),
            ("Cross-Origin-Resource-Policy", "same-origin"), ("Cache-Control", "no-store"),
        ):  # fmt: skip
            self.send_header(name, value)
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(data)

    def _check(self) -> None:
        """Refuse a page of another site: by the name it asked for, and by where it comes from."""
        if self.headers.get("Host", "") not in self.server.hosts:
            raise Refused(HTTPStatus.MISDIRECTED_REQUEST, f"Host: ask for http://{HOST}:{self.server.server_port}/")
        origin = self.headers.get("Origin")
        if origin is not None and origin not in [f"http://{host}" for host in self.server.hosts]:
            raise Refused(HTTPStatus.FORBIDDEN, "Origin: a page of another site gets nothing here")

    def _get(self) -> tuple[str, bytes]:
        path, _, query = self.path.partition("?")
        if path in ASSETS:
            package, name, kind = ASSETS[path]
            return kind, files(package).joinpath("assets", name).read_bytes()
        if path == "/once":
            if not (_is_of_this_user(self.client_address, self.server.server_port) and self.server.take_once(query)):
                raise Refused(HTTPStatus.GONE, "this URL led its user to the page once; open the one that the terminal shows")
            return "text/html", f'<!doctype html><meta http-equiv="refresh" content="0; url={self.server.url}">'.encode()
        asked = {name: values[-1] for name, values in parse_qs(query).items()}
        if path == "/about":
            return "application/json", _json(self.server.about() | {"acts": self._may_act()})
        if path == "/controllers":
            return "application/json", _json(controllers_of(self._side(asked)))
        if path == "/script":
            return "text/plain", script_of(self._side(asked).done)
        if path == "/view":
            with self.server.drawing:
                return "application/octet-stream", self._view(asked)
        raise Refused(HTTPStatus.NOT_FOUND, f"{path[:80]}: there is no such page")

    def _side(self, asked: dict[str, str]) -> Any:
        number, sides = _whole(asked, "side", 0), self.server.desk.sides
        if not 0 <= number < len(sides):
            raise Refused(HTTPStatus.BAD_REQUEST, f"side: {number}, expected 0 to {len(sides) - 1}")
        return sides[number]

    def _view(self, asked: dict[str, str]) -> bytes:
        """Return a header of JSON behind its length, and the lows and highs of every trace in the window."""
        side, desk = self._side(asked), self.server.desk
        now = side.now(_whole(asked, "since", 0), "words" in asked)
        first, end = _whole(asked, "first", now["first"]), _whole(asked, "end", now["slots"])
        window = Window.over(max(first, 0), max(end, first + 1, 1), min(max(_whole(asked, "columns", 600), 1), MOST_COLUMNS))
        draft = desk.draft
        now |= {
            "window": [window.first, window.columns, window.slots], "refused": self.server.refused + desk.refused,
            "draft": asdict(draft),
        }  # fmt: skip
        head = _json(now)
        head += b" " * (-len(head) % 4)  # the numbers behind it stand at a multiple of 4
        return struct.pack("<I", len(head)) + head + picture(side.records(), side.traces, window)

    def _may_act(self) -> bool:
        return hmac.compare_digest(self.headers.get("X-Hil-Token", "").encode(), self.server.token.encode())

    def _post(self) -> tuple[str, bytes]:
        if self.path != "/do":
            raise Refused(HTTPStatus.NOT_FOUND, f"{self.path[:80]}: wishes go to /do")
        if not self._may_act():
            raise Refused(HTTPStatus.FORBIDDEN, "X-Hil-Token: missing or wrong, so this browser only watches; open the whole URL")
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or len(length) > 9 or int(length) > MOST_BYTES:
            raise Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a request has {MOST_BYTES} bytes at most, and states its length")
        try:
            number = self.server.desk.take(msgspec.json.decode(self.rfile.read(int(length)), type=Wish))
        except (HilError, ValueError, RecursionError) as error:
            raise Refused(HTTPStatus.BAD_REQUEST, str(error)[:1000]) from error
        return "application/json", _json({"number": number})


def _is_of_this_user(client: tuple[str, int], port: int) -> bool:
    """Whether a connection over loopback is of a process of this user or of root: another who reads arguments may be faster."""
    ends = [f"{int.from_bytes(socket.inet_aton(host), sys.byteorder):08X}:{at:04X}" for host, at in (client, (HOST, port))]
    with suppress(OSError):
        for line in Path("/proc/net/tcp").read_text().splitlines()[1:]:
            _, local, remote, _, _, _, _, user, *_ = line.split()
            if [local, remote] == ends:
                return int(user) in (0, os.geteuid())
    return False


def _whole(asked: dict[str, str], name: str, default: int) -> int:
    text = asked.get(name, "")
    if not text:
        return default
    if not text.removeprefix("-").isdecimal() or len(text) > 15:
        raise Refused(HTTPStatus.BAD_REQUEST, f"{name}: {text[:40]!r}, expected a whole number")
    return int(text)


def _json(value: object) -> bytes:
    return json.dumps(plain(value)).encode()
