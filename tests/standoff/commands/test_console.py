"""``standoff console`` as a command: usage, address, port, end."""

import json
import re
import signal
import socket
import urllib.request
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")

from analysis.detectability._curves import DetectabilityCurves
from analysis.results_file import write_results
from standoff.shipped_configs import shipped_config
from tests.analysis.detectability.test_curves import curve
from tests.standoff.conftest import Command
from tests.standoff.console.processes import first_line, standoff_process

BENCH = ("--bench", shipped_config("simulated.toml"))


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.1"])
def test_it_listens_beyond_this_computer_with_a_token_only(command: Command, host: str) -> None:
    err = command.refused(2, "console", *BENCH, "--host", host)
    assert "--token" in err
    assert len(err.strip().splitlines()) == 1


def test_a_short_token_is_refused(command: Command) -> None:
    assert "at least 12 characters" in command.refused(2, "console", *BENCH, "--token", "short")


def test_a_port_that_is_taken_is_an_error_in_one_line(command: Command) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        done = command("console", *BENCH, "--port", taken.getsockname()[1])
    assert done.status == 1
    assert "--port chooses another port" in done.err
    assert len(done.err.strip().splitlines()) == 1


@pytest.mark.parametrize("host", ["bench..lab", "b" * 64])
def test_a_host_that_no_computer_can_be_called_is_an_error_in_one_line(
    command: Command, host: str
) -> None:
    err = command.refused(1, "console", *BENCH, "--host", host, "--token", "long enough to be one")
    assert f"cannot listen on {host}: it is not a host name or address" in err
    assert len(err.strip().splitlines()) == 1


def test_a_bench_file_that_is_missing_is_an_error(command: Command, tmp_path: Path) -> None:
    command.refused(1, "console", "--bench", tmp_path / "none.toml")


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Applications that were served, each ended as soon as it was ready."""
    apps: list[object] = []

    def serve(app: object, bound: socket.socket, *, ready: Callable[[], None], tls: object) -> None:
        apps.append(app)
        ready()

    monkeypatch.setattr("standoff.console.serve", serve)
    return apps


@pytest.mark.slow
def test_its_address_is_shown_and_with_a_token_the_way_in(
    command: Command, served: list[object]
) -> None:
    plain = command.done("console", *BENCH, "--port", 0)
    assert re.fullmatch(r"console at http://127\.0\.0\.1:\d+/; Ctrl-C ends\n", plain.out)
    assert plain.err == ""
    guarded = command("console", *BENCH, "--port", 0, "--token", "long enough & safe")
    assert "/login?token=long%20enough%20%26%20safe; Ctrl-C ends" in guarded.out
    assert "the connection is not encrypted" in guarded.err
    assert len(served) == 2


@pytest.mark.slow
def test_without_a_bench_it_is_for_photographs_and_a_phone_reaches_it_by_tls(
    command: Command, served: list[object], tmp_path: Path
) -> None:
    sessions = ("--sessions", tmp_path / "sessions")
    done = command.done(
        "console", *sessions, "--port", 0, "--https", "--token", "long enough to be one"
    )
    assert "console at https://127.0.0.1:" in done.out
    assert "SHA-256 of the certificate: " in done.out
    assert "\u2588" in done.out  # the code
    assert done.err == ""
    assert len(served) == 1
    err = command.refused(2, "console", *sessions, "--set", "camera.gain_db=1")
    assert "--bench" in err


@pytest.mark.slow
def test_with_curves_the_pose_can_be_judged_and_curves_that_do_not_tell_are_refused(
    command: Command, served: list[object], tmp_path: Path
) -> None:
    curves = tmp_path / "curves.json"
    write_results(curves, DetectabilityCurves(curves=[curve()]))
    document = command.document("console", *BENCH, "--port", 0, "--curves", curves)
    assert document["url"].startswith("http://127.0.0.1:")
    curves.write_text("{}")
    assert "curves.json" in command.refused(1, "console", *BENCH, "--port", 0, "--curves", curves)
    assert len(served) == 1


def test_without_its_extra_the_console_says_how_to_get_it(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("standoff.commands.console.find_spec", lambda _: None)
    err = command.refused(1, "console", *BENCH)
    assert "pip install 'standoff[console]'" in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_until_it_is_told_to_end(tmp_path: Path, number: signal.Signals) -> None:
    with standoff_process("console", *BENCH, "--port", 0, "--json", cwd=tmp_path) as process:
        url = first_line(process)["url"]
        with urllib.request.urlopen(url) as answer:
            assert b"STOP" in answer.read()
        process.send_signal(number)
        assert process.wait(300) == 0
    assert (tmp_path / "console.err").read_text() == ""
    assert json.dumps(sorted(tmp_path.iterdir(), key=str), default=str).count("sessions") == 0
