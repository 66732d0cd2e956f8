"""A page's websocket: how it begins, is replaced and is told what was not understood."""

import asyncio
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest

from standoff.console.session_run import RunView, rows_of
from standoff.console.web._view_model import plan_document

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("httpx2", reason="starlette's test client needs httpx2")
pytest.importorskip("websockets", reason="the console's extra is not installed")


from starlette.testclient import TestClient, WebSocketTestSession
from starlette.websockets import WebSocketDisconnect
from websockets import Origin
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from acquisition.plan import CapturePlan, load_plan
from standoff.console.bench_hub import BenchHub
from standoff.console.page_words import NOT_UNDERSTOOD
from standoff.console.server import open_socket, server_of
from standoff.console.web import _live_sockets as live_sockets, _live_sockets as state_cache
from standoff.console.web._application import console_app
from standoff.console.web._live_sockets import REPLACED, STATE_S, StateCache
from tests.acquisition.fakes import SETTINGS, frame
from tests.standoff.console.hub_fixtures import DEADLINE_S, idle_hub, wait_for


@pytest.fixture
def hub(tmp_path: Path) -> BenchHub:
    return idle_hub(tmp_path)


def test_the_plans_table_is_made_when_the_run_has_changed_and_not_before(
    hub: BenchHub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[RunView] = []

    def counted(view: RunView) -> dict[str, object]:
        made.append(view)
        return plan_document(view)

    monkeypatch.setattr(state_cache, "plan_document", counted)
    cache = StateCache(hub)
    assert json.loads(cache.plan(hub))["rows"] == []
    rows = rows_of(tmp_path / "new", load_plan(tmp_path / "two.toml"))
    for revision, shown in enumerate((rows, (replace(rows[0], state="done"), rows[1])), 1):
        view = RunView(session="new", plan="two", rows=shown, revision=revision)
        monkeypatch.setattr(hub.run, "view", view)
        assert [json.loads(cache.plan(hub)) for _ in range(3)] == [plan_document(view)] * 3
    assert [view.revision for view in made] == [0, 1, 2]


def test_the_state_is_made_once_for_all_pages_that_ask_within_its_interval(
    hub: BenchHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 50.0
    monkeypatch.setattr("time.monotonic", lambda: now_s)
    cache = StateCache(hub)
    first = cache.state()
    hub.tell("the lamp was changed")
    now_s += STATE_S
    assert cache.state() is first
    now_s += 0.001
    assert "the lamp was changed" in cache.state()["notices"]


OWN = "http://127.0.0.1:8470"
PAGE, OTHER = "0" * 32, "1" * 32


@contextmanager
def client_of(hub: BenchHub) -> Iterator[TestClient]:
    with TestClient(console_app(hub), client=("127.0.0.1", 50000), base_url=OWN) as client:
        yield client


def live(client: TestClient) -> Any:
    return client.websocket_connect("ws://127.0.0.1:8470/live", headers={"origin": OWN})


def received(socket: WebSocketTestSession, kind: str) -> dict[str, Any]:
    """The next document of a kind; the others are left out."""
    while True:
        document: dict[str, Any] = socket.receive_json()
        if document["type"] == kind:
            return document


@pytest.mark.parametrize("first", ["{", '{"do": "stop"}', '{"do": "hello", "viewer": "me"}'])
def test_a_page_that_does_not_say_hello_first_is_closed(hub: BenchHub, first: str) -> None:
    with client_of(hub) as client, live(client) as socket:
        socket.send_text(first)
        with pytest.raises(WebSocketDisconnect) as closed:
            socket.receive_json()
    assert closed.value.code == 1008
    assert closed.value.reason == "send hello first"


def test_a_page_that_leaves_before_its_hello_leaves_nothing_behind(hub: BenchHub) -> None:
    with client_of(hub) as client:
        with live(client):
            pass
        with live(client) as socket:
            socket.send_bytes(b"hello")
        with live(client) as socket:
            socket.send_json({"do": "hello", "viewer": PAGE})
            assert received(socket, "state")["control"]["is_mine"]
            assert hub.control.view(PAGE).viewers == 1


def test_a_page_that_is_silent_is_let_go(hub: BenchHub, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("standoff.console.web._live_sockets.HELLO_TIMEOUT_S", 0.01)
    server = server_of(console_app(hub))
    with open_socket("127.0.0.1", 0) as bound:
        thread = Thread(target=lambda: asyncio.run(server.serve(sockets=[bound])))
        thread.start()
        try:
            wait_for(lambda: server.started, "the server")
            address = f"127.0.0.1:{bound.getsockname()[1]}"
            with (
                connect(f"ws://{address}/live", origin=Origin(f"http://{address}")) as socket,
                pytest.raises(ConnectionClosed),
            ):
                socket.recv(DEADLINE_S)
            assert hub.control.view(PAGE).viewers == 0
        finally:
            server.should_exit = True
            thread.join()


def test_a_page_opened_again_takes_the_place_of_the_old_one_and_keeps_control(
    hub: BenchHub,
) -> None:
    with client_of(hub) as client, live(client) as old:
        old.send_json({"do": "hello", "viewer": PAGE, "name": "Ada"})
        assert received(old, "state")["control"]["is_mine"]
        with live(client) as new:
            new.send_json({"do": "hello", "viewer": PAGE, "name": "Ada"})
            assert received(new, "state")["control"]["is_mine"]
            with pytest.raises(WebSocketDisconnect) as closed:
                received(old, "nothing")
            assert closed.value.code == REPLACED
            # The old one's end takes nothing from the new one.
            new.send_json({"do": "gain", "gain_db": 3.0})
            new.send_json({"do": "preview", "plan": "two"})
            assert received(new, "preview")["captures"] == 2
            assert hub.control.view(PAGE).is_mine


def test_what_is_not_understood_is_told_to_that_page_alone(hub: BenchHub) -> None:
    with client_of(hub) as client, live(client) as mine, live(client) as theirs:
        for socket, viewer in ((mine, PAGE), (theirs, OTHER)):
            socket.send_json({"do": "hello", "viewer": viewer})
            received(socket, "state")
        mine.send_bytes(b"\x00")
        assert received(mine, "refused")["text"] == "a message must be text"
        mine.send_json({"do": "jump"})
        assert received(mine, "refused")["text"] == NOT_UNDERSTOOD
        theirs.send_json({"do": "home"})
        assert "You are not in control" in received(theirs, "refused")["text"]
        theirs.send_json({"do": "stop"})  # from anybody
        wait_for(lambda: bool(hub.notices), "the stop")


def test_a_page_that_sends_faster_than_it_may_is_read_at_the_pace_it_may(
    hub: BenchHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_sockets, "MESSAGES_AT_ONCE", 2)
    monkeypatch.setattr(live_sockets, "MESSAGE_PERIOD_S", 3600.0)
    with client_of(hub) as client, live(client) as hasty, live(client) as other:
        for socket, viewer in ((hasty, PAGE), (other, OTHER)):
            socket.send_json({"do": "hello", "viewer": viewer})
        for _ in range(6):
            hasty.send_json({"do": "jump"})
        for _ in range(2):
            received(hasty, "refused")
        # Others are not kept waiting, and the hasty one still sees what happens.
        other.send_json({"do": "stop"})
        wait_for(lambda: bool(hub.notices), "the stop")
        assert "refused" not in {hasty.receive_json()["type"] for _ in range(4)}


STOP = {"do": "stop", "id": "0123456789abcdef"}


def test_a_stop_is_answered_before_what_its_page_sent_before_and_counts_once(
    hub: BenchHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    is_free, stops = Event(), []
    load = hub.plans.load

    def slowly(name: str) -> CapturePlan:
        assert is_free.wait(DEADLINE_S)
        return load(name)

    monkeypatch.setattr(hub.plans, "load", slowly)
    monkeypatch.setattr(hub, "stop", lambda: stops.append(1))
    with client_of(hub) as client, live(client) as socket:
        socket.send_json({"do": "hello", "viewer": PAGE})
        socket.send_json({"do": "preview", "plan": "two"})
        for _ in range(3):  # as a page does that waits for the answer
            socket.send_json(STOP)
            assert received(socket, "stop-heard")["id"] == STOP["id"]
        assert stops == [1]
        socket.send_json(STOP | {"id": "fedcba9876543210"})
        received(socket, "stop-heard")
        assert stops == [1, 1]
        socket.send_json({"do": "ping", "number": 7})
        assert received(socket, "pong")["number"] == 7
        is_free.set()
        assert received(socket, "preview")["captures"] == 2


def test_a_stop_that_comes_again_over_a_new_connection_is_the_same(
    hub: BenchHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    stops: list[int] = []
    monkeypatch.setattr(hub, "stop", lambda: stops.append(1))
    with client_of(hub) as client:
        for _ in range(2):
            with live(client) as socket:
                socket.send_json({"do": "hello", "viewer": PAGE})
                socket.send_json(STOP)
                received(socket, "stop-heard")
    assert stops == [1]


def test_more_commands_than_can_wait_are_refused_and_none_is_lost_with_its_page(
    hub: BenchHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_sockets, "COMMANDS_WAITING", 1)
    is_free, loaded = Event(), []
    load = hub.plans.load

    def slowly(name: str) -> CapturePlan:
        assert is_free.wait(DEADLINE_S)
        loaded.append(name)
        return load(name)

    monkeypatch.setattr(hub.plans, "load", slowly)
    with client_of(hub) as client:
        with live(client) as socket:
            socket.send_json({"do": "hello", "viewer": PAGE})
            for _ in range(4):
                socket.send_json({"do": "preview", "plan": "two"})
            assert "too many commands" in received(socket, "refused")["text"]
            is_free.set()
        wait_for(lambda: len(loaded) >= 1, "the command of a page that left")


@pytest.mark.slow
def test_levels_and_picture_come_with_the_first_frame(hub: BenchHub) -> None:
    assert StateCache(hub).levels(hub) is None
    hub.picture.start()
    try:
        with client_of(hub) as client, live(client) as socket:
            socket.send_json({"do": "hello", "viewer": PAGE, "pictures": True})
            # Levels are looked for at every other state at least: none without a picture.
            seen = [socket.receive_json()["type"] for _ in range(7)]
            assert set(seen) == {"state", "plan", "measure", "sweep"}
            hub.frames.publish(frame(np.full((48, 64), 700, np.uint16), 1), SETTINGS)
            texts: list[dict[str, Any]] = []
            pictures: list[bytes] = []
            while not (pictures and any(text["type"] == "levels" for text in texts)):
                message = socket.receive()
                if message.get("bytes"):
                    pictures.append(message["bytes"])
                else:
                    texts.append(json.loads(message["text"]))
            levels = next(text for text in texts if text["type"] == "levels")
            assert sum(levels["counts"]) == 48 * 64
            socket.send_json({"do": "ack", "sequence": 1})
    finally:
        hub.picture.close()
