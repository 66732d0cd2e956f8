"""Who may see or send a picture, and how it is sent."""

import asyncio
import hashlib
import json
import socket
import ssl
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from threading import Event
from typing import Any

import cv2
import numpy as np
import pytest
from starlette.testclient import TestClient

from benchmarks.truth.hand_held import HeldPose
from standoff.console.guide import (
    Certificate,
    GuidedReference,
    GuideReference,
    Judge,
    LiveGuidance,
    StillStore,
    guide_app,
    made_certificate,
)
from standoff.console.guide._application import FRAMES_OF_ONE
from standoff.console.guide._live import MOST_FRAME_BYTES
from standoff.console.guide._stills import StillRecord
from standoff.console.photographs._uploads import MOST_WAITING, PART_BYTES
from tests.standoff.console.guide.scenes import Stills, save, wall
from tests.standoff.console.guide.serving import TOKEN, served_guide, trusting
from tests.standoff.console.hub_fixtures import wait_for

pytestmark = pytest.mark.slow

HOST = "https://phone.test"
OWN = {"Origin": HOST}
RNG = np.random.default_rng(5)
ASKED = [
    ("GET", "/"), ("GET", "/reference.jpg"), ("GET", "/stills"), ("POST", "/frames"),
    ("POST", "/find"),
    ("POST", f"/stills?sha256={'0' * 64}&bytes=1"), ("PUT", f"/stills/{'0' * 64}?offset=0&bytes=1"),
    ("GET", "/stills/any"), ("GET", "/stills/any/after.jpg"), ("GET", "/static/guide.js"),
]  # fmt: skip


class Guide:
    """The application, with a client that is paired and one that is not."""

    def __init__(self, stills: Stills, folder: Path) -> None:
        judge = Judge(GuideReference.read(stills.reference))
        self.store = StillStore(folder, judge)
        self.told: list[str] = []
        self.app = guide_app(
            [GuidedReference.of(judge, self.store)],
            token=TOKEN,
            fingerprint="AB:CD",
            tell=self.told.append,
        )
        self.stranger = TestClient(self.app, base_url=HOST, client=("192.0.2.9", 1))
        self.phone = TestClient(self.app, base_url=HOST, client=("192.0.2.7", 1))
        self.phone.get("/login", params={"token": TOKEN})


@pytest.fixture
def guide(stills: Stills, tmp_path: Path) -> Iterator[Guide]:
    made = Guide(stills, tmp_path / "guided")
    with made.phone, made.stranger:
        yield made


@pytest.mark.parametrize(("method", "path"), ASKED)
def test_nobody_sees_or_sends_a_picture_unless_paired(guide: Guide, method: str, path: str) -> None:
    answer = guide.stranger.request(method, path, headers=OWN)
    assert answer.status_code == 401
    assert "not paired" in answer.text


def test_pairing_is_told_in_the_terminal_and_the_cookie_is_for_tls_alone(guide: Guide) -> None:
    assert guide.told == ["paired with the phone at 192.0.2.7"]
    (cookie,) = guide.phone.cookies.jar
    assert cookie.secure
    login = guide.phone.get("/login", params={"token": TOKEN}, follow_redirects=False)
    said = {part.strip().lower() for part in login.headers["Set-Cookie"].split(";")}
    assert {"httponly", "secure", "samesite=strict"} <= said
    assert guide.phone.get("/").status_code == 200


def test_guessing_the_token_is_slowed_and_told(guide: Guide) -> None:
    answers = [
        guide.stranger.post("/login", data={"token": f"guess {k}"}).status_code for k in range(8)
    ]
    assert answers[:5] == [401] * 5
    assert 429 in answers[5:]
    assert guide.told[1:] == ["somebody at 192.0.2.9 is guessing the token"]


@pytest.mark.parametrize("origin", [None, "https://elsewhere.test", "http://phone.test"])
@pytest.mark.parametrize(("method", "path"), [one for one in ASKED if one[0] != "GET"])
def test_a_page_from_elsewhere_sends_nothing(
    guide: Guide, method: str, path: str, origin: str | None
) -> None:
    headers = {} if origin is None else {"Origin": origin}
    assert guide.phone.request(method, path, headers=headers, content=b"x").status_code == 403


def test_frames_of_one_phone_never_take_the_turn_of_another(
    guide: Guide, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The flooder's wait for as long as they like; the other's are judged."""
    go_on = Event()
    slow = LiveGuidance.judged

    async def judged(live: LiveGuidance, data: bytes, *, phone: str = "", **facts: Any) -> object:
        while phone == "192.0.2.8" and not go_on.is_set():
            await asyncio.sleep(0.01)
        return await slow(live, data, phone=phone, **facts)

    monkeypatch.setattr(LiveGuidance, "judged", judged)
    data = cv2.imencode(".jpg", wall().resized((640, 480)).seen([HeldPose()], RNG))[1].tobytes()
    flooder = TestClient(guide.app, base_url=HOST, client=("192.0.2.8", 1))
    with flooder, ThreadPoolExecutor(6) as pool:
        flooder.get("/login", params={"token": TOKEN})
        sent = [
            pool.submit(flooder.post, "/frames", headers=OWN, content=data)
            for _ in range(FRAMES_OF_ONE)
        ]
        try:
            wait_for(lambda: all(one.running() for one in sent), "the flood")
            time.sleep(0.5)
            refused = flooder.post("/frames", headers=OWN, content=data)
            assert refused.status_code == 429
            own = guide.phone.post("/frames", headers=OWN, content=data)
            assert own.json()["verdict"] == "unsure"  # a first frame: is the hand still?
        finally:
            go_on.set()
        assert {one.result().status_code for one in sent} == {200}


def test_the_page_runs_its_own_scripts_alone_and_shows_the_fingerprint(guide: Guide) -> None:
    answer = guide.phone.get("/")
    assert "script-src 'self'" in answer.headers["Content-Security-Policy"]
    assert "AB:CD" in answer.text
    assert "No curves are given" in answer.text
    assert "reference.jpg" in answer.text


@pytest.mark.parametrize(
    ("method", "path", "size"),
    [
        ("POST", "/frames", MOST_FRAME_BYTES),
        ("PUT", f"/stills/{'0' * 64}?offset=0&bytes=1", PART_BYTES),
    ],
)
def test_what_is_too_large_is_refused(guide: Guide, method: str, path: str, size: int) -> None:
    answer = guide.phone.request(method, path, headers=OWN, content=bytes(size + 1))
    assert answer.status_code == 413


def test_a_frame_is_judged_and_what_is_none_is_refused_in_words(
    guide: Guide, stills: Stills
) -> None:
    data = stills.reference.read_bytes()
    times_ms = ("1000.0", "1200.5")
    found = [
        guide.phone.post(f"/frames?at={at}", headers=OWN, content=data).json() for at in times_ms
    ]
    assert [one["verdict"] for one in found] == ["unsure", "go"]
    assert found[0]["faults"] == ["hold still"]
    assert found[0]["spoken"] == "hold still"
    for at in ("x", "-1", "nan", "1e5", "9" * 13):
        assert guide.phone.post(f"/frames?at={at}", headers=OWN, content=data).status_code == 422
    refused = guide.phone.post("/frames", headers=OWN, content=b"no frame")
    assert refused.status_code == 422
    assert "JPEG" in refused.json()["text"]


def test_a_still_is_sent_in_parts_and_goes_on_where_it_was(guide: Guide, stills: Stills) -> None:
    data = stills.again.read_bytes()
    sha256 = hashlib.sha256(data).hexdigest()
    facts: dict[str, str | int] = {"sha256": sha256, "bytes": len(data), "location": "keep"}

    def ask() -> dict[str, object]:
        answer: dict[str, object] = guide.phone.post("/stills", headers=OWN, params=facts).json()
        return answer

    assert ask() == {"received": 0, "is_stored": False}
    half = len(data) // 2
    for offset, part in ((0, data[:half]), (half, data[half:])):
        assert ask()["received"] == offset
        answer = guide.phone.put(
            f"/stills/{sha256}", headers=OWN, params=facts | {"offset": offset}, content=part
        )
        assert answer.status_code == 200
    assert answer.json()["is_stored"]
    assert ask()["is_stored"]
    (record,) = guide.phone.get("/stills").json()
    assert record["sha256"] == sha256
    assert record["state"] == "waiting"


def send(guide: Guide, data: bytes, sha256: str) -> tuple[int, str]:
    """Status and text of the first answer that is none to go on by, or of the last."""
    facts: dict[str, str | int] = {"sha256": sha256, "bytes": len(data)}
    answer = guide.phone.post("/stills", headers=OWN, params=facts)
    if answer.status_code == 200:
        facts["offset"] = 0
        answer = guide.phone.put(f"/stills/{sha256}", headers=OWN, params=facts, content=data)
    return answer.status_code, answer.text


def test_what_may_be_taken_later_is_no_refusal(guide: Guide, stills: Stills) -> None:
    data = stills.again.read_bytes()
    sha256 = hashlib.sha256(data).hexdigest()
    facts: dict[str, str | int] = {"bytes": len(data), "offset": 0}
    unannounced = guide.phone.put(f"/stills/{sha256}", headers=OWN, params=facts, content=data)
    damaged = send(guide, b"x" + data[1:], sha256)
    for number in range(MOST_WAITING):
        guide.store.uploads.begin(f"{number:064x}", 1)
    crowded = send(guide, data, sha256)
    answers = (unannounced.status_code, unannounced.text), damaged, crowded
    assert [status for status, _ in answers] == [409] * 3
    for (_, text), words in zip(answers, ("not announced", "send it again", "wait"), strict=True):
        assert words in text


def test_what_is_no_photograph_is_refused_before_it_is_said_to_be_stored(guide: Guide) -> None:
    data = b"no photograph"
    status, text = send(guide, data, hashlib.sha256(data).hexdigest())
    assert status == 422
    assert "not a JPEG file" in text
    assert guide.store.records() == []


def test_a_still_whose_last_answer_was_lost_is_taken_when_it_is_announced_again(
    guide: Guide, stills: Stills
) -> None:
    data = stills.again.read_bytes()
    sha256 = hashlib.sha256(data).hexdigest()
    guide.store.uploads.begin(sha256, len(data))
    guide.store.uploads.add(sha256, 0, data, len(data))
    facts: dict[str, str | int] = {"sha256": sha256, "bytes": len(data)}
    for _ in range(2):
        answer = guide.phone.post("/stills", headers=OWN, params=facts).json()
        assert answer == {"received": len(data), "is_stored": True}
    assert len(guide.store.records()) == 1


@pytest.mark.parametrize("facts", ["", "bytes=x", "bytes=1", "sha256=../x&bytes=1", "bytes=-1"])
def test_what_is_no_announcement_is_refused_in_words(guide: Guide, facts: str) -> None:
    answer = guide.phone.post(f"/stills?{facts}", headers=OWN)
    assert answer.status_code == 422
    assert answer.json()["text"]


def test_a_still_of_a_reference_that_is_not_served_waits_in_the_phone(guide: Guide) -> None:
    facts = f"sha256={'0' * 64}&bytes=1"
    assert guide.phone.post(f"/stills?{facts}&of=reference.jpg", headers=OWN).status_code == 200
    assert guide.phone.post(f"/stills?{facts}&of=another.jpg", headers=OWN).status_code == 404


@pytest.fixture
def several(stills: Stills, tmp_path: Path) -> Iterator[TestClient]:
    """A phone that is paired with a guide to four references."""
    rng = np.random.default_rng(4)
    guided = []
    for seed in (11, 12, 13, 1):
        path = save(wall(seed).seen([HeldPose()], rng), tmp_path / f"wall-{seed}.jpg")
        judge = Judge(GuideReference.read(path))
        store = StillStore(tmp_path / "guided" / path.stem, judge)
        guided.append(GuidedReference.of(judge, store))
    app = guide_app(guided, token=TOKEN, fingerprint="AB:CD")
    with TestClient(app, base_url=HOST) as phone:
        phone.get("/login", params={"token": TOKEN})
        yield phone


def test_of_several_references_the_page_lists_all_and_serves_the_one_asked_for(
    several: TestClient,
) -> None:
    page = several.get("/").text
    assert all(f"wall-{seed}.jpg" in page for seed in (11, 12, 13, 1))
    assert "No curves are given" in several.get("/?of=wall-12.jpg").text
    pictures = {several.get(f"/reference.jpg?of=wall-{seed}.jpg").content for seed in (11, 12)}
    assert len(pictures) == 2
    missing = several.get("/?of=none.jpg")  # chosen before a restart, say
    assert missing.status_code == 404
    assert "none.jpg is no reference now" in missing.text
    assert "wall-11.jpg" in missing.text
    for path in ("/reference.jpg", "/stills?of=none.jpg", "/stills?of=../wall-1.jpg"):
        assert several.get(path).status_code == 404


def test_of_several_references_the_one_that_the_camera_sees_is_named(
    several: TestClient, stills: Stills
) -> None:
    shown = stills.again.read_bytes()  # of wall 1, the last of the list
    named = [several.post("/find", headers=OWN, content=shown).json()["of"] for _ in range(2)]
    assert "wall-1.jpg" in named
    assert set(named) <= {"wall-1.jpg", None}
    other = stills.other.read_bytes()
    assert several.post("/find", headers=OWN, content=other).json() == {"of": None}


def test_a_still_goes_to_the_reference_it_was_taken_for(
    several: TestClient, stills: Stills, tmp_path: Path
) -> None:
    data = stills.again.read_bytes()
    sha256 = hashlib.sha256(data).hexdigest()
    facts: dict[str, str | int] = {"sha256": sha256, "bytes": len(data), "of": "wall-13.jpg"}
    several.post("/stills", headers=OWN, params=facts)
    several.put(f"/stills/{sha256}", headers=OWN, params=facts | {"offset": 0}, content=data)
    assert len(several.get("/stills?of=wall-13.jpg").json()) == 1
    assert several.get("/stills?of=wall-1.jpg").json() == []
    assert "1 photograph" in several.get("/").text
    assert [path.name for path in (tmp_path / "guided").iterdir()] == ["wall-13"]


@pytest.mark.parametrize(
    "path",
    ["/stills/%2e%2e/after.jpg", "/stills/x/guide.json", "/stills/one/guide.json",
     "/stills/one/%2e%2e%2fresults%2fafter.jpg", "/stills/other/after.jpg"],
)  # fmt: skip
def test_only_pictures_of_stills_are_served(stills: Stills, tmp_path: Path, path: str) -> None:
    record = StillRecord(name="one", reference="reference.jpg", sha256="0" * 64, state="done")
    for name in ("one", "other"):  # the other one is no still of the guide
        results = tmp_path / name / "results"
        results.mkdir(parents=True)
        (results / "after.jpg").write_bytes(b"a picture")
    (tmp_path / "one" / "results" / "guide.json").write_text(json.dumps(record.to_json()))
    made = Guide(stills, tmp_path)
    with made.phone:
        assert made.phone.get("/stills/one/after.jpg").content == b"a picture"
        # Changes are many, and the list is asked for every second.
        (listed,) = made.phone.get("/stills").json()
        assert listed.pop("count") == 0
        assert made.phone.get("/stills/one").json() == listed | {"changes": []}
        assert made.phone.get("/stills/other").status_code == 404
        assert made.phone.get(path).status_code == 404


def test_the_certificate_served_is_the_one_whose_fingerprint_is_shown(
    stills: Stills, tmp_path: Path
) -> None:
    with served_guide(stills.reference, tmp_path) as guide:
        port = int(guide.url.rsplit(":", 1)[1].strip("/"))
        with (
            socket.create_connection(("127.0.0.1", port)) as plain,
            trusting().wrap_socket(plain) as encrypted,
        ):
            shown = encrypted.getpeercert(binary_form=True)
        assert shown is not None
        digest = hashlib.sha256(shown).hexdigest().upper()
        assert guide.certificate.fingerprint.replace(":", "") == digest
        # Without TLS there is no answer.
        with socket.create_connection(("127.0.0.1", port)) as plain:
            plain.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            plain.settimeout(30)
            with suppress(ConnectionError):
                assert not plain.recv(100).startswith(b"HTTP")


def test_a_connection_without_a_word_is_ended_though_it_never_shook_hands(
    stills: Stills, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("standoff.console.server.HEADERS_S", 0.5)
    with served_guide(stills.reference, tmp_path) as guide:
        port = int(guide.url.rsplit(":", 1)[1].strip("/"))
        with socket.create_connection(("127.0.0.1", port)) as silent:
            silent.settimeout(30)  # asyncio's own limit is a minute
            with suppress(ConnectionError):
                assert silent.recv(100) == b""


def handshake(served: Certificate, trusted: ssl.SSLContext, host: str) -> bytes:
    """Shake hands in memory, and return the certificate that was shown."""
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    server = served.context.wrap_bio(to_server, to_client, server_side=True)
    client = trusted.wrap_bio(to_client, to_server, server_hostname=host)
    for _ in range(4):
        for side in (client, server):
            with suppress(ssl.SSLWantReadError):
                side.do_handshake()
    shown = client.getpeercert(binary_form=True)
    assert shown is not None
    return shown


HOSTS = ["127.0.0.1", "::1", "bench.test", "b\u00fccher.test"]


@pytest.mark.parametrize("host", HOSTS)
def test_a_certificate_is_for_the_host_alone_and_made_anew(host: str) -> None:
    one, other = made_certificate(host), made_certificate(host)
    assert one.fingerprint != other.fingerprint
    assert len(one.fingerprint) == 95
    assert one.context.minimum_version >= ssl.TLSVersion.TLSv1_2
    shown = handshake(one, trusting(), host)
    trusted = ssl.create_default_context(cadata=shown)
    assert handshake(one, trusted, host) == shown
    for wrong in {*HOSTS} - {host}:
        with pytest.raises(ssl.SSLCertVerificationError, match=r"mismatch|doesn't match"):
            handshake(one, trusted, wrong)
    with pytest.raises(ssl.SSLCertVerificationError):
        handshake(other, trusted, host)
