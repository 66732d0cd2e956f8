"""Who is let in: rules first, then the whole application."""

import json
import shutil
import ssl
import subprocess
from contextlib import closing
from http.client import HTTPConnection
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from standoff.console import access as login_throttle

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("httpx2", reason="starlette's test client needs httpx2")


from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from standoff.console.access import Access, Allowance, LoginThrottle, is_loopback_host
from standoff.console.bench_hub import BenchHub
from standoff.console.session_library import SessionLibrary, UnknownSessionError, is_session_name
from standoff.console.web._application import console_app
from tests.acquisition.fakes import FakeClock
from tests.standoff.console.hub_fixtures import idle_hub
from tests.standoff.console.served import answered, served


def test_after_those_at_once_each_turn_takes_its_time() -> None:
    clock = FakeClock()
    allowance = Allowance(at_once=3, period_s=2.0, clock=clock)
    assert [allowance.take() for _ in range(5)] == [0.0, 0.0, 0.0, 2.0, 4.0]
    clock.now_s += 4.0
    assert allowance.wait_s == 2.0
    clock.now_s += 2.0
    assert allowance.wait_s == 0.0
    assert allowance.take() == 0.0
    assert not allowance.is_full


def test_a_rest_gives_back_no_more_than_there_was() -> None:
    clock = FakeClock()
    allowance = Allowance(at_once=2, period_s=1.0, clock=clock)
    allowance.take()
    clock.now_s += 1000.0
    assert allowance.is_full
    assert [allowance.take() for _ in range(3)] == [0.0, 0.0, 1.0]


@given(pauses_s=st.lists(st.floats(0, 3), min_size=1, max_size=40))
def test_in_any_time_no_more_are_taken_than_that_time_allows(pauses_s: list[float]) -> None:
    clock = FakeClock()
    begin_s = clock.now_s
    allowance = Allowance(at_once=5, period_s=1.0, clock=clock)
    taken = 0
    for pause_s in pauses_s:
        clock.now_s += pause_s
        if allowance.wait_s == 0:
            assert allowance.take() == pytest.approx(0, abs=1e-9)  # sums of pauses are rounded
            taken += 1
    assert taken <= 5 + (clock.now_s - begin_s) + 1e-9


def guesses_in(throttle: LoginThrottle, clock: FakeClock, seconds: float, *peers: str) -> int:
    """Guess as often as possible, a hundred times a second."""
    made = 0
    for _ in range(round(100 * seconds)):
        for peer in peers:
            if throttle.wait_s(peer) == 0:
                throttle.note_wrong(peer)
                made += 1
        clock.now_s += 0.01
    return made


def test_after_five_guesses_one_a_second() -> None:
    clock = FakeClock()
    throttle = LoginThrottle(clock)
    assert guesses_in(throttle, clock, 0.5, "192.0.2.7") == 5
    assert throttle.wait_s("192.0.2.7") == pytest.approx(0.5)
    assert guesses_in(throttle, clock, 100.0, "192.0.2.7") == pytest.approx(100, abs=1)


def test_nobody_is_slowed_down_by_another_address() -> None:
    clock = FakeClock()
    throttle = LoginThrottle(clock)
    guesses_in(throttle, clock, 3.5, "192.0.2.7")
    assert throttle.wait_s("192.0.2.7") > 0
    assert throttle.wait_s("192.0.2.8") == 0


def test_the_addresses_of_one_computer_count_as_one() -> None:
    clock = FakeClock()
    throttle = LoginThrottle(clock)
    own = [f"2001:db8::{number:x}" for number in range(20)]
    assert guesses_in(throttle, clock, 0.5, *own) == 5
    assert throttle.wait_s("2001:db8:0:1::1") == 0
    guesses_in(throttle, clock, 0.5, "::ffff:192.0.2.7")
    assert throttle.wait_s("192.0.2.7") > 0  # the same address, written for IPv6


def test_very_many_addresses_share_one_allowance_and_no_more_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(login_throttle, "MAX_PEERS", 3)
    clock = FakeClock()
    throttle = LoginThrottle(clock)
    peers = [f"192.0.2.{number}" for number in range(200)]
    assert guesses_in(throttle, clock, 0.5, *peers) == (3 + 1) * 5
    assert throttle.wait_s("198.51.100.1") > 0  # a new one, too
    clock.now_s += 10.0  # forgotten, as each of them may guess five times again
    guesses_in(throttle, clock, 0.5, "198.51.100.1")
    assert throttle.wait_s("198.51.100.1") > 0
    assert throttle.wait_s("198.51.100.2") == 0


TOKEN = "a long enough secret"
OWN = "http://127.0.0.1:8470"
HELLO = {"do": "hello", "viewer": "0" * 32}


@pytest.fixture
def hub(tmp_path: Path) -> BenchHub:
    return idle_hub(tmp_path)


def client_of(hub: BenchHub, peer: str = "127.0.0.1", token: str | None = None) -> TestClient:
    return TestClient(
        console_app(hub, token=token), client=(peer, 50000), follow_redirects=False, base_url=OWN
    )


@pytest.mark.parametrize(
    "host", ["127.0.0.1", "127.3.4.5", "::1", "[::1]", "localhost", "LOCALHOST"]
)
def test_loopback_is_this_computer(host: str) -> None:
    assert is_loopback_host(host)


@pytest.mark.parametrize(
    "host", ["0.0.0.0", "::", "192.168.1.2", "bench.lab", "", "127.0.0.1.x.org"]
)
def test_everything_else_is_not(host: str) -> None:
    assert not is_loopback_host(host)


def test_this_computer_is_served_without_a_token(hub: BenchHub) -> None:
    with client_of(hub) as client:
        for path in ("/", "/sessions", "/doctor", "/static/console.css"):
            assert client.get(path).status_code == 200


@pytest.mark.parametrize("path", ["/", "/sessions", "/doctor", "/static/bench.js", "/login"])
def test_another_computer_gets_401_without_a_token(hub: BenchHub, path: str) -> None:
    with client_of(hub, peer="192.0.2.7") as client:
        assert client.get(path).status_code == 401


def test_a_foreign_name_for_this_computer_gets_401(hub: BenchHub) -> None:
    # What a page of elsewhere can do: have its own name resolve to 127.0.0.1.
    with client_of(hub) as client:
        assert client.get("/", headers={"host": "evil.example:8470"}).status_code == 401


def test_with_a_token_everybody_needs_it_once(hub: BenchHub) -> None:
    for peer in ("127.0.0.1", "192.0.2.7"):
        with client_of(hub, peer=peer, token=TOKEN) as client:
            refused = client.get("/")
            assert refused.status_code == 401
            assert 'name="token"' in refused.text
            assert client.get("/login", params={"token": "a wrong secret"}).status_code == 401
            entered = client.get("/login", params={"token": TOKEN})
            assert (entered.status_code, entered.headers["location"]) == (303, "/")
            assert "HttpOnly" in entered.headers["set-cookie"]
            assert "SameSite=strict" in entered.headers["set-cookie"]
            assert TOKEN not in entered.headers["set-cookie"]
            assert client.get("/").status_code == 200


def test_the_token_may_be_sent_from_the_form(hub: BenchHub) -> None:
    with client_of(hub, peer="192.0.2.7", token=TOKEN) as client:
        assert client.post("/login", data={"token": "x"}).status_code == 401
        assert client.post("/login", content=b"x" * 10_000).status_code == 413
        assert client.post("/login", data={"token": TOKEN}).status_code == 303


@pytest.mark.parametrize(
    "cookie", ["", "standoff_console=", "standoff_console=ü", "a=b; ;=", "\xff"]
)
def test_no_other_cookie_lets_in(hub: BenchHub, cookie: str) -> None:
    with client_of(hub, peer="192.0.2.7", token=TOKEN) as client:
        sent = {"cookie": cookie.encode("latin-1")}
        assert client.get("/", headers=sent).status_code == 401  # type: ignore[arg-type]  # httpx takes bytes


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "http://127.0.0.1:9",
        "https://127.0.0.1:84700",
        "https://127.0.0.1:8470",
        "ws://127.0.0.1:8470",
        "null",
        "",
        None,
    ],
)
def test_a_websocket_of_another_site_is_refused(hub: BenchHub, origin: str | None) -> None:
    headers = {} if origin is None else {"origin": origin}
    with (
        client_of(hub) as client,
        pytest.raises(WebSocketDisconnect),
        client.websocket_connect("ws://127.0.0.1:8470/live", headers=headers),
    ):
        pass


@pytest.mark.parametrize("scheme", ["http", "https"])
def test_the_origin_has_the_scheme_that_the_console_is_served_by(
    tmp_path: Path, hub: BenchHub, scheme: str
) -> None:
    other = {"http": "https", "https": "http"}[scheme]
    certificate = self_signed(tmp_path) if scheme == "https" else None
    with served(hub, certificate=certificate) as (host, port):
        context = None
        if certificate is not None:
            context = ssl.create_default_context(cafile=certificate)
        address = f"{host}:{port}"
        url = f"{'ws' if context is None else 'wss'}://{address}/live"
        with connect(url, origin=Origin(f"{scheme}://{address}"), ssl=context) as socket:
            socket.send(json.dumps(HELLO))
            assert json.loads(socket.recv())["type"] == "state"
        with pytest.raises(InvalidStatus, match="403"):
            connect(url, origin=Origin(f"{other}://{address}"), ssl=context)


def self_signed(folder: Path) -> Path:
    """A certificate of 127.0.0.1 with its key, in one file; skips the test without openssl."""
    program = shutil.which("openssl")
    if program is None:
        pytest.skip("openssl, which makes the certificate, is not installed")
    made = folder / "console.pem"
    subprocess.run(
        [program, "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj",
         "/CN=127.0.0.1", "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(made),
         "-out", str(folder / "certificate.pem")],
        check=True, capture_output=True,
    )  # fmt: skip
    made.write_bytes(made.read_bytes() + (folder / "certificate.pem").read_bytes())
    return made


def test_a_websocket_without_the_token_is_refused(hub: BenchHub) -> None:
    with (
        client_of(hub, peer="192.0.2.7", token=TOKEN) as client,
        pytest.raises(WebSocketDisconnect),
        client.websocket_connect("/live", headers={"origin": OWN}),
    ):
        pass


def test_a_websocket_of_our_own_page_is_served(hub: BenchHub) -> None:
    with (
        client_of(hub) as client,
        client.websocket_connect("ws://127.0.0.1:8470/live", headers={"origin": OWN}) as socket,
    ):
        socket.send_json(HELLO)
        assert socket.receive_json()["type"] == "state"


@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    [
        "/sessions/..",
        "/sessions/../../etc/passwd",
        "/sessions/%2e%2e",
        "/sessions/%2e%2e%2fsecret/report",
        "/sessions/..%5c..%5csecret",
        "/sessions/secret%00",
        "/sessions/.hidden",
        "/sessions/nothing",
        "/sessions/nothing/report",
        "/sessions/link",
        "/sessions/link/report",
        "/static/../web.py",
        "/static/%2e%2e/web.py",
        "/static//etc/passwd",
        "/etc/passwd",
        "/nothing",
    ],
)
def test_paths_that_lead_elsewhere_get_404(hub: BenchHub, tmp_path: Path, path: str) -> None:
    secret = tmp_path / "secret"
    (secret / "results").mkdir(parents=True)
    for name in ("session.json", "results/report.html"):
        (secret / name).write_text("secret")
    hub.sessions.folder.mkdir()
    (hub.sessions.folder / "link").symlink_to(secret)
    status, body = raw_get(hub, path)
    assert status == 404
    assert b"secret</" not in body


def test_the_raw_requests_above_reach_what_is_there(hub: BenchHub) -> None:
    assert raw_get(hub, "/sessions")[0] == 200
    assert raw_get(hub, "/static/bench.js")[0] == 200


def raw_get(hub: BenchHub, path: str) -> tuple[int, bytes]:
    """Ask a real server for a path just as it is written: clients clean paths before they ask."""
    with served(hub) as address, closing(HTTPConnection(*address, timeout=30)) as connection:
        connection.putrequest("GET", path)
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, answer.read()


NAMES = (b"[", b"[::1", b"http://[", b"a b", b"\xff", b"", b":", b"127.0.0.1:abc", b"[::g]", b"%00")


@pytest.mark.parametrize("token", [None, TOKEN])
def test_names_that_are_none_are_refused_and_never_a_fault(
    hub: BenchHub, token: str | None
) -> None:
    handshake = (
        b"Upgrade: websocket",
        b"Sec-WebSocket-Version: 13",
        b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
    )
    with served(hub, token=token) as address:
        for name in NAMES:
            page = answered(address, b"GET / HTTP/1.1", b"Host: " + name)
            live = b"GET /live HTTP/1.1"
            host = answered(address, live, b"Host: " + name, b"Origin: http://a", *handshake)
            origin = answered(address, live, b"Host: 127.0.0.1", b"Origin: " + name, *handshake)
            strange = answered(
                address, live, b"Host: 127.0.0.1", b"Origin: http://" + name, *handshake
            )
            for status in (page, host, origin, strange):
                assert 400 <= status < 500, name


@given(name=st.text(max_size=30) | st.text("[]:/@%.a1", max_size=12))
def test_no_name_is_a_fault_of_the_rules(name: str) -> None:
    assert not Access.is_own_page(origin=name, host="127.0.0.1:8470", scheme="ws")
    Access.is_own_page(origin=f"http://{name}", host=name, scheme="ws")
    assert not Access(TOKEN).may_enter(peer="127.0.0.1", host=name, cookies="")
    Access(None).may_enter(peer="127.0.0.1", host=name, cookies="")


def test_guesses_are_slowed_down_and_the_pages_are_told(
    hub: BenchHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = FakeClock()
    monkeypatch.setattr("standoff.console.entrance.LoginThrottle", lambda: LoginThrottle(clock))
    app = console_app(hub, token=TOKEN)
    guesser, other = (
        TestClient(app, client=(peer, 50000), follow_redirects=False, base_url=OWN)
        for peer in ("192.0.2.7", "192.0.2.8")
    )
    told = [guesser.post("/login", data={"token": f"guess {n}"}).status_code for n in range(6)]
    assert told == [401] * 5 + [429]
    early = guesser.get("/login", params={"token": TOKEN})
    assert (early.status_code, early.headers["retry-after"]) == (429, "1")  # even if it is right
    assert guesser.get("/login").status_code == 401  # the form is still shown
    assert hub.notices[-1].text == "Somebody at 192.0.2.7 is guessing the console's token."
    assert other.get("/login", params={"token": TOKEN}).status_code == 303
    clock.now_s += 1.0
    assert guesser.get("/login", params={"token": TOKEN}).status_code == 303


@pytest.mark.slow
@given(name=st.text(max_size=120) | st.sampled_from(["..", ".", "a/b", "a\\b", "\0", "\udcff"]))
def test_no_name_leads_out_of_the_folder(name: str) -> None:
    library = SessionLibrary(Path("/nowhere/sessions"))
    with pytest.raises(UnknownSessionError):
        library.path_of(name)
    if is_session_name(name):
        path = library.path_for(name)
        assert (path.parent, path.name) == (library.folder, name)
        assert name not in (".", "..")
    else:
        with pytest.raises(UnknownSessionError):
            library.path_for(name)


def test_pages_keep_to_themselves(hub: BenchHub) -> None:
    with client_of(hub) as client:
        for path in ("/", "/sessions", "/doctor", "/nothing", "/static/bench.js"):
            answer = client.get(path)
            policy = answer.headers["content-security-policy"]
            assert "default-src 'none'" in policy
            assert "unsafe" not in policy
            assert "http:" not in policy
            assert answer.headers["x-content-type-options"] == "nosniff"
            assert answer.headers["referrer-policy"] == "no-referrer"


def test_nothing_that_is_served_names_another_address() -> None:
    folder = Path(console_app.__code__.co_filename).parent
    files = [*folder.glob("static/*"), *folder.glob("templates/*")]
    assert len(files) > 10
    for file in files:
        named = file.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
        named = named.replace("http://127.0.0.1", "")
        assert "http://" not in named, file
        assert "https://" not in named, file
        assert "//cdn" not in named, file


@pytest.mark.parametrize("value", ["", "ü", "0" * 64, '"'])
def test_only_its_own_value_of_the_cookie_lets_in(value: str) -> None:
    access = Access(TOKEN)
    about = {"peer": "192.0.2.7", "host": "192.0.2.1"}
    assert not access.may_enter(**about, cookies=f"{access.cookie_name}={value}")
    assert access.may_enter(**about, cookies=f"{access.cookie_name}={access.cookie_value}")


def test_two_consoles_of_one_host_keep_each_its_own_operator() -> None:
    # A browser sends both: cookies know no ports.
    consoles = Access(TOKEN), Access(TOKEN + "other")
    both = "; ".join(f"{one.cookie_name}={one.cookie_value}" for one in consoles)
    for one in consoles:
        assert one.may_enter(peer="192.0.2.7", host="192.0.2.1", cookies=both)


@given(token=st.text(min_size=1), guess=st.text())
def test_only_the_token_is_the_token(token: str, guess: str) -> None:
    access = Access(token)
    assert access.is_token(token)
    assert access.is_token(guess) == (guess == token)
    assert not access.may_enter(peer="127.0.0.1", host="127.0.0.1", cookies=guess)
