"""Who may send a photograph to the console, and what is answered to what is none."""

import hashlib
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("httpx2", reason="starlette's test client needs httpx2")

from starlette.testclient import TestClient

from standoff.console.bench_hub import ConsoleHub
from standoff.console.photographs import PART_BYTES
from standoff.console.web import console_app
from tests.standoff.console.photographs.test_inbox import jpeg

HOST = "https://console.test"
OWN = {"Origin": HOST}
TOKEN = "a token that is long enough"
DATA = jpeg()
SHA256 = hashlib.sha256(DATA).hexdigest()
ANNOUNCED = f"/photographs/arrived?sha256={SHA256}&bytes={len(DATA)}&name=wall.jpg"
PART = f"/photographs/arrived/{SHA256}?offset=0&bytes={len(DATA)}&name=wall.jpg"


@pytest.fixture
def hub(tmp_path: Path) -> ConsoleHub:
    return ConsoleHub(sessions=tmp_path / "sessions")


@pytest.fixture
def page(hub: ConsoleHub) -> Iterator[TestClient]:
    with TestClient(console_app(hub, token=TOKEN), base_url=HOST) as made:
        made.get("/login", params={"token": TOKEN})
        yield made


def test_a_photograph_arrives_in_parts_and_is_shown_in_a_sandbox(
    hub: ConsoleHub, page: TestClient
) -> None:
    assert page.post(ANNOUNCED, headers=OWN).json() == {"received": 0, "is_stored": False}
    half = len(DATA) // 2
    assert page.put(PART, headers=OWN, content=DATA[:half]).json()["received"] == half
    assert page.post(ANNOUNCED, headers=OWN).json()["received"] == half  # as after a lost link
    rest = PART.replace("offset=0", f"offset={half}")
    assert page.put(rest, headers=OWN, content=DATA[half:]).json()["is_stored"]
    (one,) = hub.photographs.arrived()
    assert one.path.read_bytes() == DATA
    shown = page.get(f"/photographs/arrived/{SHA256}")
    assert shown.content == DATA
    assert "sandbox" in shown.headers["Content-Security-Policy"]
    assert "wall.jpg" in page.get("/photographs").text
    again = page.post(ANNOUNCED, headers=OWN)  # the same file chosen once more
    assert again.json() == {"received": len(DATA), "is_stored": True}
    assert hub.photographs.arrived() == [one]
    assert one.path.read_bytes() == DATA


@pytest.mark.parametrize("origin", [None, "https://elsewhere.test", "http://console.test"])
def test_a_page_from_elsewhere_sends_nothing(
    hub: ConsoleHub, page: TestClient, origin: str | None
) -> None:
    headers = {} if origin is None else {"Origin": origin}
    assert page.post(ANNOUNCED, headers=headers).status_code == 403
    assert page.put(PART, headers=headers, content=DATA).status_code == 403
    assert not hub.sessions.folder.exists()


def test_without_the_token_nobody_sends_or_sees_a_photograph(hub: ConsoleHub) -> None:
    with TestClient(console_app(hub, token=TOKEN), base_url=HOST) as stranger:
        for method, path in (("POST", ANNOUNCED), ("PUT", PART), ("GET", PART), ("GET", "/guide/")):
            assert stranger.request(method, path, headers=OWN, content=b"").status_code == 401


@pytest.mark.parametrize(
    ("path", "data", "status", "said"),
    [
        (ANNOUNCED.replace("wall.jpg", "..%2Fwall.jpg"), b"", 422, "cannot be the name"),
        (ANNOUNCED.replace("wall.jpg", "wall.exe"), b"", 422, "not have the name of a photograph"),
        (ANNOUNCED.replace(f"bytes={len(DATA)}", "bytes=99999999999"), b"", 422, "at most 64 MB"),
        (ANNOUNCED.replace(SHA256, "0"), b"", 422, "SHA-256"),
        (PART, bytes(PART_BYTES + 1), 413, "at most 1024 kB"),
        (PART, DATA, 409, "was not announced"),
    ],
)
def test_what_is_no_photograph_is_refused_in_a_sentence(
    page: TestClient, path: str, data: bytes, status: int, said: str
) -> None:
    method = "POST" if "arrived?" in path else "PUT"
    answer = page.request(method, path, headers=OWN, content=data)
    assert answer.status_code == status
    assert said in answer.json()["text"]


def test_what_is_not_what_its_name_says_is_gone_again(hub: ConsoleHub, page: TestClient) -> None:
    data = b"no photograph"
    sha256 = hashlib.sha256(data).hexdigest()
    facts = f"bytes={len(data)}&name=wall.jpg"
    page.post(f"/photographs/arrived?sha256={sha256}&{facts}", headers=OWN)
    answer = page.put(f"/photographs/arrived/{sha256}?offset=0&{facts}", headers=OWN, content=data)
    assert (answer.status_code, answer.json()["text"]) == (422, "wall.jpg: it is not a JPEG file")
    assert [path for path in hub.sessions.folder.rglob("*") if path.is_file()] == []
