"""What is fetched for the pose card and sent from it, over a real server."""

import json
from collections.abc import Iterator
from contextlib import closing
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")

from analysis.detectability import DetectabilityCurves
from standoff.console.bench_hub import BenchHub
from standoff.console.pose_curves import MOST_BYTES
from tests.analysis.detectability.test_curves import curve
from tests.standoff.console.hub_fixtures import DEADLINE_S, idle_hub
from tests.standoff.console.served import Address, answer_of, sent, served

pytestmark = pytest.mark.slow

OWN = "a" * 32
CURVES = DetectabilityCurves(curves=[curve()]).model_dump_json(by_alias=True).encode()


@pytest.fixture
def hub(tmp_path: Path) -> BenchHub:
    made = idle_hub(tmp_path)
    made.control.join(OWN, "Ada")
    made.control.take(OWN)
    return made


@pytest.fixture
def address(hub: BenchHub) -> Iterator[Address]:
    with served(hub) as made:
        yield made


def asked(
    address: Address, method: str, path: str, data: bytes | None = None, **headers: str
) -> tuple[int, str, bytes]:
    """Status, media type and body of an answer."""
    with closing(HTTPConnection(*address, timeout=DEADLINE_S)) as connection:
        connection.request(method, path, data, headers)
        answer = connection.getresponse()
        return answer.status, answer.getheader("content-type", ""), answer.read()


def posted(
    address: Address, data: bytes, name: str = "sent.json", viewer: str = OWN, **headers: str
) -> tuple[int, Any]:
    own = {"Origin": f"http://127.0.0.1:{address[1]}", "X-Viewer": viewer}
    status, _, body = asked(address, "POST", f"/pose/curves?name={name}", data, **(own | headers))
    return status, json.loads(body)


def test_a_file_is_taken_from_the_page_in_control_and_listed(
    address: Address, hub: BenchHub
) -> None:
    assert posted(address, CURVES) == (200, {"file": "curves/sent.json"})
    status, _, body = asked(address, "GET", "/pose/curves")
    assert status == 200
    assert json.loads(body) == {
        "revision": hub.curves.view.revision,
        "files": ["curves/sent.json"],
        "curves": [],
    }


@pytest.mark.parametrize(
    ("viewer", "headers"),
    [
        ("b" * 32, {}),  # a page that watches
        ("", {}),
        (OWN, {"Origin": "http://elsewhere.example"}),
        (OWN, {"Origin": "null"}),
    ],
)
def test_a_file_of_anybody_else_is_not_taken(
    address: Address, hub: BenchHub, viewer: str, headers: dict[str, str]
) -> None:
    status, answer = posted(address, CURVES, viewer=viewer, **headers)
    assert (status, answer["text"]) == (403, "You are not in control: take control first.")
    assert not hub.sessions.folder.exists()


def test_while_nobody_is_in_control_nothing_is_taken(tmp_path: Path) -> None:
    hub = idle_hub(tmp_path)
    with served(hub) as address:
        assert posted(address, CURVES, viewer="")[0] == 403
        assert posted(address, CURVES, viewer="None")[0] == 403
    assert not hub.sessions.folder.exists()


@pytest.mark.parametrize("name", ["..%2Fa.json", "%2Fetc%2Fa.json", "a.txt", "", "%00.json"])
def test_a_name_that_leads_elsewhere_gets_one_line(
    address: Address, hub: BenchHub, name: str
) -> None:
    status, answer = posted(address, CURVES, name)
    assert (status, list(answer)) == (422, ["text"])
    assert "must be called" in answer["text"]
    assert not hub.sessions.folder.exists()


@pytest.mark.parametrize("data", [b"", b"no", b"[" * 100_000, b"{}", b'{"schema": 1}'])
def test_a_file_that_holds_no_curves_gets_one_line(
    address: Address, hub: BenchHub, data: bytes
) -> None:
    status, answer = posted(address, data)
    assert (status, "sent.json" in answer["text"]) == (422, True)
    assert not hub.sessions.folder.exists()


def test_a_file_that_is_too_large_is_not_read_to_its_end(address: Address, hub: BenchHub) -> None:
    host = f"127.0.0.1:{address[1]}"
    head = (
        f"POST /pose/curves?name=a.json HTTP/1.1\r\nHost: {host}\r\nX-Viewer: {OWN}\r\n"
        f"Origin: http://{host}\r\nConnection: close\r\n"
    )
    stated = f"{head}Content-Length: {10**12}\r\n\r\n".encode()
    with sent(address, stated) as connection:
        assert answer_of(connection).startswith(b"HTTP/1.1 413")
    chunk = b"%x\r\n" % (MOST_BYTES + 1) + b" " * (MOST_BYTES + 1) + b"\r\n"
    unstated = f"{head}Transfer-Encoding: chunked\r\n\r\n".encode() + chunk  # and never the end
    with sent(address, unstated) as connection:
        assert answer_of(connection).startswith(b"HTTP/1.1 413")
    assert not hub.sessions.folder.exists()


def test_the_reference_is_served_by_its_number_until_it_is_another(
    address: Address, hub: BenchHub
) -> None:
    hub.pose.choose("before", np.full((4, 6), 700, np.uint16), 4095)
    picture = hub.pose.view.picture
    assert picture is not None
    for view in ("photo", "edges"):
        path = f"/pose/reference.png?view={view}&of={picture.number}"
        assert asked(address, "GET", path) == (200, "image/png", picture.png(view))
    for path in ("?of=1", "", f"?view=all&of={picture.number}", f"?of={picture.number}0"):
        assert asked(address, "GET", f"/pose/reference.png{path}")[0] == 404
    hub.pose.choose("after", np.full((4, 6), 700, np.uint16), 4095)
    gone = f"/pose/reference.png?view=photo&of={picture.number}"
    assert asked(address, "GET", gone)[0] == 404
    hub.pose.clear()
    assert asked(address, "GET", gone)[0] == 404


def test_without_the_token_nothing_of_the_pose_is_served_or_taken(tmp_path: Path) -> None:
    hub = idle_hub(tmp_path)
    hub.control.join(OWN, "Ada")
    hub.control.take(OWN)
    hub.pose.choose("before", np.full((4, 6), 700, np.uint16), 4095)
    picture = hub.pose.view.picture
    assert picture is not None
    with served(hub, token="long enough to be safe") as address:
        path = f"/pose/reference.png?view=photo&of={picture.number}"
        assert asked(address, "GET", path)[0] == 401
        assert asked(address, "GET", "/pose/curves")[0] == 401
        headers = {"Origin": f"http://127.0.0.1:{address[1]}", "X-Viewer": OWN}
        assert asked(address, "POST", "/pose/curves?name=a.json", CURVES, **headers)[0] == 401
    assert not hub.sessions.folder.exists()
