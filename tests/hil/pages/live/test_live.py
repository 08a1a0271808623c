"""The live page without a browser: what its server gives and refuses, what a desk does, and that no run waits for it."""

from __future__ import annotations

import ctypes
import http.client
import json
import os
import signal
import socket
import struct
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit
from urllib.request import urlopen

import numpy as np
import pytest
from msgspec import structs

from hil.compose import compose
from hil.errors import HilError
from hil.experiment import Experiment, load_experiment
from hil.log.read import read_run
from hil.log.records import Field, Schema
from hil.pages.live import Side, Tail, Trace, server
from hil.pages.live.about import Window, about, picture, thinned
from hil.pages.live.desk import Desk, Wish
from hil.pages.live.script import Scripted, read_script
from hil.pages.live.server import MOST_BYTES, MOST_CONNECTIONS, LivePage
from hil.pages.live.watch import RequestedRun, _run, show_log, watch
from hil.runtime.clock import PacedClock
from hil.session import Session, run_session
from hil.session.replay.recorded import changes_of
from tests.waiting import until


@dataclass
class Page:
    """A run that is watched, and who talks to its server."""

    folder: Path
    asked: list[RequestedRun]
    url: str = ""
    once: str = ""
    sessions: list[Session] = field(default_factory=list)
    status: int = -1
    number: int = 0

    def begin(self, status: str = "paused") -> None:
        there = threading.Event()

        def opened(page: LivePage) -> None:
            self.url = page.url
            there.set()

        def run() -> None:
            self.status = watch(self.asked, stay=False, opened=opened, finished=self.sessions.append)

        self.thread = threading.Thread(target=run, daemon=True)
        self.thread.start()
        assert there.wait(60)
        self.reach(self.url)
        until(lambda: all(self.view(side=i)["status"] == status for i in range(len(self.asked))), "the runs")

    def reach(self, url: str) -> None:
        self.token, self.port = parse_qs(urlsplit(url).query)["token"][0], urlsplit(url).port

    def request(self, method: str, path: str, body: bytes | None = None, **headers: str) -> tuple[int, bytes]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        try:
            connection.request(method, path, body, {name.replace("_", "-"): value for name, value in headers.items()})
            answer = connection.getresponse()
            return answer.status, answer.read()
        finally:
            connection.close()

    def wish(self, **said: Any) -> tuple[int, Any]:
        status, data = self.request("POST", "/do", json.dumps(said).encode(), X_Hil_Token=self.token)
        answer = json.loads(data)
        self.number = answer.get("number") or self.number
        return status, answer

    def view(self, **asked: Any) -> Any:
        status, data = self.request("GET", "/view?" + "&".join(f"{name}={value}" for name, value in asked.items()))
        assert status == 200, data
        (size,) = struct.unpack_from("<I", data)
        return json.loads(data[4 : 4 + size]) | {"numbers": np.frombuffer(data, "<f4", offset=4 + size)}

    def settled(self, state: str) -> Any:
        """Return what became of the last wish."""
        until(lambda: (d := self.view()["draft"])["number"] == self.number and d["state"] != "computing", "the certificate")
        draft = self.view()["draft"]
        assert draft["state"] == state, draft
        return draft

    def end(self) -> None:
        if self.thread.is_alive():
            self.wish(do="end")
        self.thread.join(60)
        assert not self.thread.is_alive()


def asked(folder: Path, name: str, number: list[int], sets: Sequence[str] = (), **about: Any) -> RequestedRun:
    def path(experiment: Experiment) -> Path:
        number.append(1)
        return folder / f"{experiment.name}-{experiment.seed}-{len(number)}.mcap"

    def load(sets: list[str], seed: int | None) -> Experiment:
        return load_experiment(name, sets, seed=seed)

    return RequestedRun(load=partial(load, ["duration=600", *sets]), path=path, **about)


@pytest.fixture
def page(tmp_path: Path, composer: None) -> Iterator[Page]:
    page = Page(tmp_path, [asked(tmp_path, "dc-motor-hinf", [], paused=True)])
    page.begin()
    yield page
    page.end()


@pytest.fixture
def still() -> Iterator[Page]:
    """The page of a run that has not begun: its server answers as that of any other."""
    desk = Desk([Side(PacedClock(1.0, True), acts=True)])
    with closing(desk), LivePage(desk, lambda: about(desk.sides, "here"), 0) as live:
        page = Page(Path(), [], url=live.url, once=live.url_once())
        page.reach(live.url)
        yield page


def test_virtual_time_is_paced_and_begins_at_once_unless_it_is_held(tmp_path: Path) -> None:
    plain = asked(tmp_path, "dc-motor-hinf", [])
    begun, paused = plain.pacer(), structs.replace(plain, paused=True).pacer()
    assert begun is not None and paused is not None and (begun.paused, paused.paused) == (False, True)
    assert structs.replace(plain, clock="real").pacer() is None


def test_a_page_says_what_it_waits_for_before_a_run_begins(tmp_path: Path) -> None:
    waits: list[str] = []

    def path(experiment: Experiment) -> Path:
        waits.append(side.waits)
        raise HilError("no log")

    side = Side()
    with pytest.raises(HilError, match="no log"):
        _run([structs.replace(asked(tmp_path, "dc-motor-hinf", []), path=path)], [side], None, None)
    assert waits == ["composing dc-motor-hinf: gains and certificate"] and side.status == "ended"


def test_a_spike_is_never_thinned_away() -> None:
    records = np.zeros(10_000, [("y", "<f8"), ("slot", "<i8")])
    records["slot"] = np.arange(10_000) + 500
    records["y"][[1240, 7777]] = 9.0, -9.0
    window = Window.over(500, 10_500, 300)
    low, high = thinned(records, "y", window)
    assert window.columns <= 301 and np.nanmax(high) == 9.0 and np.nanmin(low) == -9.0
    at = int(np.nanargmax(high))
    assert window.first + at * window.slots <= 1740 < window.first + (at + 1) * window.slots
    sparse, _ = thinned(records[::1000], "y", Window.over(0, 12_000, 12_000))
    assert np.count_nonzero(np.isfinite(sparse)) == 10
    age = Trace(panel="delays", topic="/x", field="y", unit="samples")  # below 0: no packet has come yet
    assert np.nanmin(np.frombuffer(picture({"/x": records}, [age], window), "<f4")) == 0.0


def test_a_reader_keeps_what_it_has_while_the_oldest_are_forgotten() -> None:
    schema = Schema(name="hil/msg/Demo", fields=(Field(type="float64", name="y"), Field(type="int64", name="slot")))
    tail = Tail(schema, most=160)
    for k in range(20):
        tail.put(k, schema.pack(float(k), k))
    seen = tail.records()
    for k in range(20, 500):
        tail.put(k, schema.pack(float(k), k))
    assert seen["slot"].tolist() == list(range(20))
    newest = tail.records()["slot"]
    assert 10 <= len(newest) <= 20 and newest.tolist() == list(range(500 - len(newest), 500))


def test_only_loopback_pages_with_the_token_change_anything(page: Page) -> None:
    wish = json.dumps({"do": "step"}).encode()
    status, data = page.request("POST", "/do", wish)
    assert status == 403 and b"X-Hil-Token" in data
    assert page.request("POST", "/do", wish, X_Hil_Token="guess")[0] == 403
    assert page.request("POST", "/do", wish, X_Hil_Token=page.token, Origin="http://evil.example")[0] == 403
    assert page.request("GET", "/about", Origin="null")[0] == 403
    assert page.request("GET", "/about", Host="evil.example")[0] == 421, "another name that leads here is refused"
    assert page.request("GET", "/../session.py")[0] == 404
    assert page.view()["refused"] == 6 and page.view()["slots"] == 0
    assert json.loads(page.request("GET", "/about")[1])["acts"] is False
    assert page.request("GET", "/about", Origin=f"http://localhost:{page.port}", X_Hil_Token=page.token)[0] == 200
    assert page.wish(do="step")[0] == 200
    until(lambda: page.view()["slots"] == 1, "the step")


def test_a_url_for_the_arguments_of_a_browser_leads_to_the_page_once(still: Page) -> None:
    path = still.once.partition(f":{still.port}")[2]
    assert still.token not in path and still.request("GET", path[:-1])[0] == 410
    status, data = still.request("GET", path)
    assert status == 200 and f"url={still.url}".encode() in data
    status, data = still.request("GET", path)
    assert status == 410 and still.token.encode() not in data


def test_a_url_in_the_arguments_of_a_browser_leads_no_other_user_to_the_page(
    still: Page, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    """Who looks for new programs all the time asks before the browser does."""
    path, linux = still.once.partition(f":{still.port}")[2], ctypes.CDLL(None)
    if os.geteuid() == 0:
        linux.setfsuid(12345)  # of this thread: sockets that it opens are another user's
    else:
        monkeypatch.setattr(server.os, "geteuid", lambda: 0)
    try:
        assert still.request("GET", path)[0] == 410
    finally:
        linux.setfsuid(0)
        monkeypatch.undo()
    assert still.request("GET", path)[0] == 200, "it was not spent"


def test_the_page_may_load_and_connect_to_itself_alone(still: Page) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", still.port)
    connection.request("GET", "/")
    answer = connection.getresponse()
    policy = answer.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy and "unsafe" not in policy and "script-src 'self'" in policy
    answer.read()
    connection.close()
    for path in ("/live.js", "/scopes.js", "/devices.js", "/act.js", "/live.css", "/page.css", "/uPlot.js", "/uPlot.css"):
        assert still.request("GET", path)[0] == 200


NO_WISHES = (
    b"", b"[]", b"[" * 50_000, b'{"do": "fly"}', b'{"do": "step", "slots": 0}', b'{"do": "speed", "speed": 1e99}', b"\xff\xfe",
    b'{"do": "step", "more": 1}', b'{"do": "check", "path": "end"}', b'{"do": "apply", "sides": [7]}',
    b'{"do": "\xff"}', b'{"do": "speed", "speed": NaN}', b'{"do": "restart", "seed": -1}',
)  # fmt: skip


def test_a_wish_that_is_none_is_refused(still: Page) -> None:
    for number, body in enumerate(NO_WISHES, 1):
        status, data = still.request("POST", "/do", body, X_Hil_Token=still.token)
        assert status == 400 and json.loads(data)["error"], body
        assert still.view()["refused"] == number


def test_ten_megabytes_are_refused_before_they_are_read(still: Page) -> None:
    for said in (str(10_000_000), "-1", "much", "9" * 30, "\xb2"):
        with socket.create_connection(("127.0.0.1", still.port), timeout=30) as link:
            link.sendall(f"POST /do HTTP/1.1\r\nHost: 127.0.0.1:{still.port}\r\nX-Hil-Token: {still.token}\r\n"
                         f"Content-Length: {said}\r\n\r\n".encode("latin-1"))  # fmt: skip
            assert b" 413 " in link.recv(4096)
    assert still.request("POST", "/do", b"x" * (MOST_BYTES + 1), X_Hil_Token=still.token)[0] == 413
    assert still.view()["refused"] == 6


def test_a_request_that_drips_in_is_given_up(still: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    """A byte now and then is no sign of life: the time is that of the whole request, head and body."""
    monkeypatch.setattr(server, "TIMEOUT_S", 0.5)
    body = f"POST /do HTTP/1.1\r\nHost: 127.0.0.1:{still.port}\r\nX-Hil-Token: {still.token}\r\nContent-Length: 9000\r\n\r\n"
    for head in ("GET /", body):
        with socket.create_connection(("127.0.0.1", still.port), timeout=0.05) as link:
            link.sendall(head.encode())
            for _ in range(200):
                with suppress(TimeoutError, ConnectionError):
                    if not link.recv(1):
                        break
                with suppress(ConnectionError):
                    link.sendall(b"x")
            else:
                raise AssertionError("the page still waits for the rest")
    assert still.view()["refused"] == 0


def test_what_is_no_request_is_counted(still: Page) -> None:
    for number, said in enumerate((b"PUT / HTTP/1.1\r\n\r\n", b"GET / HTTP/7\r\n\r\n", b"GET /" + 65_532 * b"x"), 1):
        with socket.create_connection(("127.0.0.1", still.port), timeout=30) as link:
            link.sendall(said)
            assert b"Error response" in link.makefile("rb").read()
        assert still.view()["refused"] == number


def test_who_takes_no_answer_gets_no_other(still: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of the requests that lay ready was answered, ten seconds long, and so was each of one that had gone."""
    answered: list[str] = []

    def get(handler: server.Handler) -> tuple[str, bytes]:
        answered.append(handler.path)
        return "text/plain", bytes(10_000_000)

    monkeypatch.setattr(server, "TIMEOUT_S", 0.2)
    monkeypatch.setattr(server.Handler, "_get", get)
    with socket.create_connection(("127.0.0.1", still.port), timeout=30) as link:
        link.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{still.port}\r\n\r\n".encode() * 20)
        until(lambda: bool(answered) and not serving(), "the end of the connection")
    assert len(answered) == 1


def serving() -> bool:
    """Return whether a connection is served."""
    return any("process_request_thread" in thread.name for thread in threading.enumerate())


def test_pictures_are_drawn_one_after_the_other(still: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    """Thirty browsers that ask all the time left the run's process so little that Ctrl-C took half a minute."""
    drawing, never = threading.Lock(), threading.Event()

    def drawn(*_: object) -> bytes:
        assert drawing.acquire(blocking=False), "another one is being drawn"
        never.wait(0.1)
        drawing.release()
        return b""

    monkeypatch.setattr(server, "picture", drawn)
    with ThreadPoolExecutor(3) as browsers:
        assert all(found["slots"] == 0 for found in browsers.map(lambda _: still.view(), range(3)))


def test_a_change_is_shown_with_its_certificate_and_acts_when_it_is_applied(page: Page) -> None:
    page.wish(do="check", path="network.ca.law", value={"kind": "packet", "latency": "1 ms", "loss": 0.8})
    assert page.settled("ready")["claims"][0]["state"] == "refused"
    assert page.view(words=1)["certificate"]["state"] == "certified", "what is shown does not act"
    page.wish(do="check", path="network.ca.law", value={"kind": "markov", "matrix": [[0.5, 0.6], [0.7, 0.3]]})
    assert "network.ca.law" in page.settled("refused")["message"]
    page.wish(do="check", path="controller", value={"kind": "virtual-wall"})
    assert "controller" in page.settled("refused")["message"]
    assert page.view()["refused"] == 2
    page.wish(do="step", slots=7)
    until(lambda: page.view()["slots"] == 7, "seven slots")
    page.wish(do="apply", path="network.ca.law", value={"kind": "constant", "age": 1})
    assert "slot 7" in page.settled("armed")["message"]
    page.wish(do="apply", path="reference", value=[1.25])
    page.settled("armed")
    page.wish(do="step", slots=5)
    until(lambda: page.view()["slots"] == 12, "five slots")
    page.end()
    first = page.sessions[0]
    log = Path(first.summary["log"]["path"])
    assert changes_of(first.run) == [
        (7, "network.ca.law", {"kind": "constant", "age": 1}), (7, "reference", [1.25]), (12, "end", None)
    ]  # fmt: skip
    again = run_session(
        load_experiment("dc-motor-hinf", ["duration=600"]), path=page.folder / "again.mcap", onlooker=Scripted(read_script(log))
    )  # fmt: skip
    assert again.summary["log"]["sha256"] == first.summary["log"]["sha256"]


def test_what_a_part_raises_while_a_change_is_computed_is_said_and_the_next_change_is_taken(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The thread that computes ended, and the page waited for ever."""
    with monkeypatch.context() as context:
        context.setattr(Side, "claim", lambda side, after=None: 1 // 0)
        page.wish(do="check", path="network.ca.law", value={"kind": "constant", "age": 0})
        assert "network.ca.law" in page.settled("refused")["message"]
    page.wish(do="check", path="network.ca.law", value={"kind": "constant", "age": 0})
    assert page.settled("ready")["claims"][0]["state"] == "certified"


def test_a_run_begins_anew_with_another_seed_and_a_log_of_its_own(page: Page) -> None:
    page.wish(do="step", slots=3)
    until(lambda: page.view()["slots"] == 3, "three slots")
    page.wish(do="restart", seed=5)
    until(lambda: json.loads(page.request("GET", "/about")[1])["runs"][0].get("seed") == 5, "the next run")
    page.end()
    assert [session.summary["seed"] for session in page.sessions] == [0, 5]
    assert page.sessions[0].summary["slots"] == 3


def test_no_run_waits_for_browsers_that_stall(page: Page) -> None:
    """They ask and never read, and leave a few places: the run goes on, and who reads is served."""
    stalled = []
    for _ in range(MOST_CONNECTIONS - 8):
        link = socket.create_connection(("127.0.0.1", page.port), timeout=30)
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
        link.sendall(f"GET /uPlot.js HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n\r\n".encode() * 50)
        stalled.append(link)
    page.wish(do="step", slots=500)
    until(lambda: page.view()["slots"] == 500, "the run to go on")
    for link in stalled:
        link.close()


def test_a_connection_too_many_is_closed_at_once_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "TIMEOUT_S", 60.0)  # none of the others ends meanwhile
    desk = Desk([Side()])
    with LivePage(desk, dict, 0) as live:
        links, answers = [], []
        for _ in range(MOST_CONNECTIONS + 1):  # one after the other: few may wait to be taken
            links.append(socket.create_connection(("127.0.0.1", live.server_port), timeout=30))
            with suppress(ConnectionError):
                links[-1].sendall(f"GET /live.css HTTP/1.1\r\nHost: {live.hosts[0]}\r\n\r\n".encode())
                answers.append(links[-1].recv(1))
        assert [*filter(None, answers)] == [b"H"] * MOST_CONNECTIONS and live.refused == 1
        for link in links:
            link.close()
    desk.close()


def test_two_experiments_run_beside_each_other_on_the_same_delays(tmp_path: Path) -> None:
    number: list[int] = []
    names = ("dc-motor-local-fast", "dc-motor-hinf-fast")
    page = Page(tmp_path, [asked(tmp_path, name, number, paused=True) for name in names])
    page.begin()
    page.wish(do="apply", path="network.ca.law", value={"kind": "constant", "age": 1})
    claims = page.settled("armed")["claims"]
    assert [claim["state"] for claim in claims] == ["refused", "certified"]
    page.wish(do="check", path="controller", value={"kind": "virtual-wall"})
    assert "controller" in page.settled("refused")["message"], "the process that composes goes on"
    page.wish(do="step", slots=40)
    until(lambda: all(page.view(side=i)["slots"] == 40 for i in (0, 1)), "forty slots")
    page.end()
    assert len(page.sessions) == 2
    one, two = (session.run.arrays["/network/sc"] for session in page.sessions)
    assert one["age"].tolist() == two["age"].tolist() and len(one) >= 40


def test_a_log_is_shown_as_it_was_and_takes_no_change(tmp_path: Path) -> None:
    session = run_session(load_experiment("dc-motor-hinf", ["duration=4"]), path=tmp_path / "a.mcap")
    side = Side()
    side.show(read_run(tmp_path / "a.mcap"), compose(load_experiment("dc-motor-hinf", ["duration=4"]), certify=False))
    now = side.now(0, words=True)
    assert (now["status"], now["first"], now["slots"]) == ("log", 0, 80)
    assert now["certificate"]["state"] == "certified" == session.summary["certificate"]["state"]
    desk = Desk([side])
    try:
        for do in ("apply", "pause", "restart"):
            with pytest.raises(HilError, match="only watches"):
                desk.take(Wish(do=do))
    finally:
        desk.close()
    rows = np.frombuffer(picture(side.records(), side.traces, Window.over(0, 80, 80)), "<f4").reshape(len(side.traces), 2, 80)
    run, kinds = read_run(tmp_path / "a.mcap"), ("change late", "change")
    run.events.extend({"slot": 1, "t_s": 0.05, "kind": kind, "severity": "info", "message": "", "data": {}} for kind in kinds)
    with pytest.raises(HilError, match="event of slot 1: a change without path and value"):
        Side().show(run, side.loop)
    at = next(i for i, trace in enumerate(side.traces) if trace.topic == "/reference")
    assert rows[at, 0].tolist() == rows[at, 1].tolist() == [0.0] * 20 + [3.0] * 60


def test_a_log_is_served_until_a_signal_comes(tmp_path: Path) -> None:
    run_session(load_experiment("dc-motor-hinf", ["duration=1"]), path=tmp_path / "a.mcap")
    plain, answers = signal.getsignal(signal.SIGINT), list[int]()

    def look(url: str) -> None:
        until(lambda: signal.getsignal(signal.SIGINT) != plain, "who waits for a signal")
        with urlopen(url, timeout=30) as answer:
            answers.append(answer.status)
        os.kill(os.getpid(), signal.SIGINT)

    run = read_run(tmp_path / "a.mcap")
    show_log(run, "a.mcap", opened=lambda page: threading.Thread(target=look, args=(page.url,), daemon=True).start())
    assert answers == [200] and signal.getsignal(signal.SIGINT) == plain


def test_a_signal_ends_two_runs_and_both_are_handed_on(tmp_path: Path) -> None:
    names, sessions = ["dc-motor-hinf", "dc-motor-h2"], list[Session]()
    runs = [asked(tmp_path, name, [], paused=True) for name in names]

    def paused(url: str, side: int) -> bool:
        with urlopen(f"{url.partition('?')[0]}view?side={side}", timeout=30) as answer:
            return b'"status":"paused"' in answer.read().replace(b'": "', b'":"')

    def end(url: str) -> None:
        until(lambda: paused(url, 0) and paused(url, 1), "the runs")
        os.kill(os.getpid(), signal.SIGINT)

    def opened(page: LivePage) -> None:
        threading.Thread(target=end, args=(page.url,), daemon=True).start()

    assert watch(runs, opened=opened, finished=sessions.append) == 130
    assert [session.summary["experiment"] for session in sessions] == names


def test_a_run_may_begin_anew_with_every_seed_of_63_bits() -> None:
    desk = Desk([Side(acts=True)])
    try:
        for seed in (None, 0, 2**63 - 1):
            assert desk.take(Wish(do="restart", seed=seed))
        for seed in (-1, 2**63):
            with pytest.raises(HilError, match=f"seed: {seed}, expected a whole number from 0 on"):
                desk.take(Wish(do="restart", seed=seed))
    finally:
        desk.close()


def test_a_script_of_more_changes_than_a_run_takes_is_refused_while_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "many.jsonl"
    line = '{"slot": 1, "field": "reference", "value": [1.0]}\n'
    path.write_text(line * 10_000)
    assert len(read_script(path)) == 10_000
    path.write_text(line * 10_001)
    with pytest.raises(HilError, match=r"line 10001: more than 10000 changes; a run takes no more"):
        read_script(path)
