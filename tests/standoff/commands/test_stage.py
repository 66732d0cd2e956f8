"""``standoff stage`` over a pseudo-terminal, with a stage that lives faster than time."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from acquisition.stages._serial_link import open_serial_port
from hil_mocks.devices import SimulatedStage, StageFaults
from hil_mocks.stages._grbl import GrblFaults, GrblFirmware
from hil_mocks.stages._serial_stage import LineFaults, SerialStage, StageProtocol
from standoff.shipped_configs import shipped_config
from tests.standoff.conftest import Command, Outcome

pytestmark = pytest.mark.waits

FASTER = 20.0
START_TIMEOUT_S = 120.0

StageCommand = Callable[..., Outcome]


@pytest.fixture
def serve() -> Iterator[Callable[[StageProtocol, float], SerialStage]]:
    with ExitStack() as served:
        yield lambda protocol, factor: served.enter_context(
            SerialStage(protocol, clock=lambda: time.monotonic() * factor)
        )


Serve = Callable[[StageProtocol, float], SerialStage]


def options(protocol: StageProtocol, stage: SerialStage) -> list[str]:
    return [
        "--bench",
        str(shipped_config(f"{protocol}_stage.toml")),
        "--set",
        f"stage.port={stage.port}",
        "--set",
        "stage.settle_s=0.05",
    ]


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["grbl", "zaber"])
def test_home_and_move_are_two_processes_where_the_controller_knows_its_position(
    command: Command, serve: Serve, protocol: StageProtocol, tmp_path: Path
) -> None:
    served = serve(protocol, FASTER)
    bench = options(protocol, served)
    err = command.refused(1, "stage", "move", "200", *bench)
    assert "standoff stage home" in err
    assert len(err.strip().splitlines()) == 1

    status = json.loads(command("stage", *bench, "status", "--json").out)
    assert (status["is_homed"], status["position_mm"]) == (False, None)

    command.done("stage", "home", *bench)
    log = tmp_path / "wire.log"
    shown = command.document("stage", *bench, "--set", f"stage.wire_log={log}", "move", "140.25")
    assert shown["is_homed"]
    assert shown["state"] == "idle"
    assert shown["limits_mm"] == [120.5 if protocol == "grbl" else 120.0, 500.0]
    assert shown["info"]["driver"] == protocol
    assert shown["position_mm"] == pytest.approx(140.25, abs=0.004)
    assert served.true_height_mm == pytest.approx(shown["position_mm"], abs=0.05)
    assert " > " in log.read_text()
    command.done("stage", "stop", *bench)


@pytest.mark.slow
def test_move_homes_first_where_it_is_told_to(command: Command, serve: Serve) -> None:
    served = serve("grbl", FASTER)
    command.done("stage", "move", "125", "--home", *options("grbl", served))
    assert served.true_height_mm == pytest.approx(125.0, abs=0.05)


@pytest.mark.slow
def test_a_hard_limit_is_told_with_its_code_and_unlock_and_home_are_the_way_back(
    command: Command, serve: Serve
) -> None:
    served = serve("grbl", FASTER)
    bench = options("grbl", served)
    port = open_serial_port(served.port, 115200)
    port.write(b"$21=1\n$X\n$J=G91G21Z-500F1200\n")
    heard, deadline = b"", time.monotonic() + START_TIMEOUT_S
    while b"ALARM:1\r\n" not in heard and time.monotonic() < deadline:
        heard += port.read()
    port.close()
    shown = json.loads(command("stage", "status", *bench, "--json").out)
    assert shown["state"] == "alarm"
    assert "ALARM:1 (a limit switch was hit" in shown["warnings"][0]
    assert "ALARM:1 (" in command.refused(1, "stage", "home", *bench)
    unlocked_stage = command.document("stage", "unlock", *bench)
    assert (unlocked_stage["state"], unlocked_stage["is_homed"]) == ("idle", False)
    assert unlocked_stage["warnings"] == []
    command.done("stage", "move", "140", "--home", *bench)
    assert served.true_height_mm == pytest.approx(140.0, abs=0.05)


def test_a_port_in_use_says_how_to_stop_the_stage(command: Command, serve: Serve) -> None:
    served = serve("zaber", FASTER)
    port = open_serial_port(served.port, 115200)
    done = command("stage", "stop", *options("zaber", served))
    port.close()
    assert done.status == 1
    assert done.err.startswith("standoff: the stage was not told to stop: ")
    assert "is in use by another program" in done.err
    assert "press Ctrl-C there" in done.err


@pytest.mark.parametrize(
    ("protocol", "lines"),
    [("grbl", b"$X\n$J=G91G21Z-175F1200\n"), ("zaber", b"/1 1 move rel 380000\n")],
)
@pytest.mark.parametrize("is_json", [True, False])
def test_a_stop_says_first_that_what_another_program_left_running_has_stopped(
    command: Command, serve: Serve, protocol: StageProtocol, lines: bytes, is_json: bool
) -> None:
    served = serve(protocol, 1.0)  # 175 mm and more take 9 s
    start_mm = served.true_height_mm
    port = open_serial_port(served.port, 115200)
    port.write(lines)
    time.sleep(0.3)
    port.close()
    done = command("stage", "stop", *options(protocol, served), *(["--json"] if is_json else []))
    stopped_mm = served.true_height_mm
    assert done.status == 0, done.err
    assert 0.0 < abs(stopped_mm - start_mm) < 150.0
    first = (done.err if is_json else done.out).splitlines()[0]
    assert first.removeprefix("note: ") == "the stage has stopped"
    if is_json:
        assert json.loads(done.out)["stopped"] is True
    time.sleep(0.1)
    assert served.true_height_mm == stopped_mm


@pytest.mark.parametrize("is_json", [True, False])
def test_a_stop_is_done_where_the_stage_stopped_whatever_else_is_the_matter(
    command: Command, serve: Serve, is_json: bool
) -> None:
    served = serve("grbl", FASTER)
    assert isinstance(served.firmware, GrblFirmware)
    served.firmware.lose_settings()
    done = command.done("stage", "stop", *options("grbl", served), *(["--json"] if is_json else []))
    assert "$102 is 800" in done.err
    if is_json:
        shown = json.loads(done.out)
        assert (shown["stopped"], shown["position_mm"], shown["state"]) == (True, None, "unknown")
        assert "$102" in shown["warnings"][0]
    else:
        assert done.out == "the stage has stopped\n"


@pytest.mark.slow
def test_a_stop_that_nobody_confirms_says_that_first(command: Command, serve: Serve) -> None:
    served = serve("grbl", FASTER)
    served.line.faults = LineFaults(mute=True)
    err = command.refused(1, "stage", "stop", *options("grbl", served))
    assert err.startswith("standoff: it is not certain that the Grbl stage on ")
    assert len(err.strip().splitlines()) == 1
    assert "emergency stop" in err


@pytest.mark.parametrize(
    ("driver", "said"),
    [("simulated", "the stage has stopped"), ("manual_stage", "a person moves this stage")],
)
def test_a_stage_without_a_controller_answers_a_stop_too(
    command: Command, driver: str, said: str
) -> None:
    done = command.done("stage", "stop", "--bench", shipped_config(f"{driver}.toml"))
    assert done.out.splitlines()[0] == said


@pytest.mark.slow
def test_a_dead_line_is_one_line_with_the_remedy(command: Command, serve: Serve) -> None:
    served = serve("zaber", FASTER)
    served.line.faults = LineFaults(garbled=True)
    err = command.refused(1, "stage", "status", *options("zaber", served))
    assert len(err.strip().splitlines()) == 1
    assert "baud" in err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("protocol", "action", "number"),
    [
        ("grbl", "move", signal.SIGINT),
        ("grbl", "home", signal.SIGINT),
        ("zaber", "move", signal.SIGINT),
        ("grbl", "move", signal.SIGTERM),
    ],
)
def test_ctrl_c_and_sigterm_stop_the_stage_under_control(
    command: Command, serve: Serve, protocol: StageProtocol, action: str, number: signal.Signals
) -> None:
    # In real time: homing from 300 mm takes 9 s, the move 14 s.
    served = serve(protocol, 1.0)
    bench = options(protocol, served)
    served.plant.place(121.0 if action == "move" else 300.0)
    if action == "move":
        command.done("stage", "home", *bench)
    start_mm = served.true_height_mm
    words = ["stage", action, *(["400"] if action == "move" else []), *bench]
    process = subprocess.Popen(
        [sys.executable, "-c", "from standoff.cli import main; main()", *words],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        deadline = time.monotonic() + START_TIMEOUT_S
        while abs(served.true_height_mm - start_mm) < 5.0 and time.monotonic() < deadline:
            time.sleep(0.01)
        process.send_signal(number)
        out, err = process.communicate(timeout=START_TIMEOUT_S)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 128 + number, err
    assert out == ""
    stopped_mm = served.true_height_mm
    time.sleep(0.2)
    assert served.true_height_mm == stopped_mm
    assert 121.0 < stopped_mm < 399.0
    shown = json.loads(command("stage", "status", *bench, "--json").out)
    # A homing that was broken off is none; a move that was, keeps its height.
    assert shown["is_homed"] == (action == "move")


def test_the_simulated_stage_obeys_too(command: Command) -> None:
    bench = shipped_config("simulated.toml")
    moved = command.document("stage", "--bench", bench, "move", "200.25", "--home")
    assert moved["position_mm"] == pytest.approx(200.248)


def test_ctrl_c_tells_that_the_stage_has_stopped(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(stage: SimulatedStage, _: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(SimulatedStage, "home", interrupted)
    done = command("stage", "home", "--bench", shipped_config("simulated.toml"))
    assert done.status == 130
    assert done.err.splitlines()[0] == "note: the stage has stopped"


def test_a_stop_that_fails_on_ctrl_c_is_told(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(stage: SimulatedStage, _: float) -> None:
        stage.faults = StageFaults(unplugged=True)
        raise KeyboardInterrupt

    monkeypatch.setattr(SimulatedStage, "home", interrupted)
    done = command("stage", "home", "--bench", shipped_config("simulated.toml"))
    assert done.status == 130
    assert "note: stopping the stage failed: the simulated stage does not answer" in done.err


def test_the_manual_stage_asks_the_operator(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = iter(["150", "200.4"])
    monkeypatch.setattr("builtins.input", lambda: next(answers))
    bench = shipped_config("manual_stage.toml")
    assert (
        command.document("stage", "move", "200", "--home", "--bench", bench)["position_mm"] == 200.4
    )


@pytest.mark.slow
def test_a_hang_of_the_controller_is_one_line(command: Command, serve: Serve) -> None:
    served = serve("zaber", FASTER)
    served.line.faults = LineFaults(mute=True)
    assert "check its power" in command.refused(1, "stage", "home", *options("zaber", served))


def test_a_state_that_does_not_move_is_named(command: Command, serve: Serve) -> None:
    served = serve("grbl", FASTER)
    assert isinstance(served.firmware, GrblFirmware)
    served.firmware.faults = GrblFaults(shows_state="Door:1")
    assert "Door" in command.refused(1, "stage", "home", *options("grbl", served))
