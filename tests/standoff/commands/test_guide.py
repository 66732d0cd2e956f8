"""``standoff guide`` as a command: what is refused, what is printed, the end."""

import json
import shutil
import signal
import socket
import ssl
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")

from starlette.applications import Starlette
from starlette.testclient import TestClient

from analysis.detectability._curves import DetectabilityCurves
from analysis.results_file import write_results
from tests.analysis.detectability.test_curves import curve
from tests.standoff.conftest import Command
from tests.standoff.console.guide.conftest import stills as stills
from tests.standoff.console.guide.scenes import Stills
from tests.standoff.console.processes import first_line, standoff_process

HERE = ("--host", "127.0.0.1", "--port", 0)


@dataclass(frozen=True, kw_only=True)
class Served:
    app: Starlette
    tls: ssl.SSLContext


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> list[Served]:
    """What was served, each ended as soon as it was ready."""
    found: list[Served] = []

    def serve(
        app: Starlette, bound: socket.socket, *, ready: Callable[[], None], tls: ssl.SSLContext
    ) -> None:
        found.append(Served(app=app, tls=tls))
        ready()

    monkeypatch.setattr("standoff.console.serve", serve)
    return found


@pytest.mark.slow
def test_it_says_how_to_pair_and_to_whom_it_is_served(
    command: Command, served: list[Served], stills: Stills, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    done = command.done("guide", stills.reference, *HERE, "--out", out)
    assert "https://127.0.0.1:" in done.out
    assert "/login?token=" in done.out
    assert "SHA-256 of the certificate: " in done.out
    assert "Served to this computer alone" in done.out
    assert "█" in done.out or "▀" in done.out  # the code
    document = command.document("guide", stills.reference, *HERE, "--out", out)
    assert document["entry"].startswith(document["url"] + "login?token=")
    assert len(served) == 2
    assert not out.exists()  # nothing was sent


@pytest.mark.slow
def test_a_curve_judges_poses_by_what_can_be_found(
    command: Command, served: list[Served], stills: Stills, tmp_path: Path
) -> None:
    curves = tmp_path / "curves.json"
    write_results(curves, DetectabilityCurves(curves=[curve()]))
    pages = []
    for more in ((), ("--curves", curves)):
        document = command.document("guide", stills.reference, *HERE, "--out", tmp_path, *more)
        with TestClient(served[-1].app, base_url=document["url"]) as phone:
            pages.append(phone.get(document["entry"]).text)
    assert ["No curves are given" in page for page in pages] == [True, False]
    curves.write_text("{}")
    err = command.refused(1, "guide", stills.reference, *HERE, "--curves", curves)
    assert "curves.json" in err


def test_what_needs_curves_is_refused_without(command: Command, tmp_path: Path) -> None:
    err = command.refused(2, "guide", tmp_path / "a.jpg", "--curve-noise", 2)
    assert "--curve-noise needs --curves" in err


@pytest.mark.parametrize("option", ["--psf", "--noise", "--curves"])
def test_a_file_that_is_missing_is_named_before_anything_is_served(
    command: Command, stills: Stills, tmp_path: Path, option: str
) -> None:
    err = command.refused(1, "guide", stills.reference, *HERE, option, tmp_path / "none.json")
    assert "none.json" in err
    assert len(err.strip().splitlines()) == 1


def test_a_reference_that_cannot_be_read_is_an_error_in_one_line(
    command: Command, tmp_path: Path
) -> None:
    err = command.refused(1, "guide", tmp_path / "none.jpg", *HERE)
    assert "none.jpg" in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.slow
def test_a_folder_of_references_is_served_as_one(
    command: Command, served: list[Served], stills: Stills, tmp_path: Path
) -> None:
    folder = tmp_path / "references"
    folder.mkdir()
    assert "contains no image" in command.refused(1, "guide", folder, *HERE)
    shutil.copy(stills.reference, folder / "mole.jpg")
    shutil.copy(stills.other, folder / "bridge.jpg")
    command.done("guide", folder, *HERE, "--out", tmp_path / "out")
    assert len(served) == 1
    shutil.copy(stills.other, folder / "mole.jpeg")
    assert "two references are named mole" in command.refused(1, "guide", folder, *HERE)


def test_without_its_extra_the_guide_says_how_to_get_it(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("standoff.commands.guide.find_spec", lambda _: None)
    assert "pip install 'standoff[console]'" in command.refused(1, "guide", "a.jpg")


def test_without_a_network_the_address_has_to_be_named(
    command: Command, monkeypatch: pytest.MonkeyPatch, stills: Stills
) -> None:
    monkeypatch.setattr("standoff.console.guide.network_address", lambda: None)
    assert "--host" in command.refused(2, "guide", stills.reference)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "0"])
def test_an_address_that_no_phone_can_open_is_refused(
    command: Command, monkeypatch: pytest.MonkeyPatch, stills: Stills, host: str
) -> None:
    class Bound(socket.socket):  # nothing is opened to the network
        def getsockname(self) -> tuple[str, int]:
            return ("::" if ":" in host else "0.0.0.0"), 8471

    monkeypatch.setattr("standoff.console.open_socket", lambda *_: Bound())
    err = command.refused(2, "guide", stills.reference, "--host", host)
    assert "no phone can open it" in err


def test_a_host_that_is_no_name_is_refused_in_one_line(command: Command, stills: Stills) -> None:
    err = command.refused(1, "guide", stills.reference, "--host", "\u00fc" * 70)
    assert "cannot listen on" in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.slow
def test_it_serves_by_tls_until_it_is_told_to_end(tmp_path: Path, stills: Stills) -> None:
    arguments = ("guide", stills.reference, *HERE, "--json")
    with standoff_process(*arguments, cwd=tmp_path) as process:
        entry = first_line(process)["entry"]
        context = ssl.create_default_context()
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        cookies = urllib.request.HTTPCookieProcessor()
        opener = urllib.request.build_opener(urllib.request.HTTPSHandler(context=context), cookies)
        with opener.open(entry) as answer:
            assert b"Take it again from here" in answer.read()
        process.send_signal(signal.SIGINT)
        assert process.wait(300) == 0
    assert "paired with the phone at 127.0.0.1" in (tmp_path / "guide.err").read_text()
    assert json.dumps(sorted(path.name for path in tmp_path.iterdir())).count("guided") == 0
