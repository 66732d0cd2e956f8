"""``standoff mock``: the simulated bench as a GigE camera, to practise without hardware."""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated

import typer
from typer import BadParameter, Option

from acquisition.printable import on_one_line
from hil_mocks.stages import StageProtocol
from standoff import terminal
from standoff.shipped_configs import shipped_config

if TYPE_CHECKING:
    from hil_mocks.practice_bench import StageEmulator

READ_BYTES = 4096


def _checked_address(address: str) -> str:
    from hil_mocks.gige import checked_loopback_address

    try:
        return checked_loopback_address(address)
    except ValueError as error:
        raise BadParameter(str(error)) from error


@terminal.command()
def mock(
    address: Annotated[str, Option(callback=_checked_address)] = "127.0.0.1",
    bench: Annotated[Path | None, Option()] = None,
    settings: terminal.BenchKeys = None,
    target: Annotated[str, Option()] = "edge",
    orientation: Annotated[float, Option()] = 0.0,
    stage_protocol: Annotated[StageProtocol | None, Option()] = None,
) -> None:
    """Serve the simulated bench as a GigE Vision camera, and its stage, until Ctrl-C.

    It accepts these commands on stdin: place TARGET [DEGREES], height MM, fault NAME=VALUE,
    fault none, restart, drop-control, status.

    Options
    -------
    address: Loopback address of the camera: 127.x.y.z.
    bench: Bench file (TOML) with a simulated section; simulated.toml by default.
    target: Target under the camera.
    orientation: Orientation of the target in degrees.
    stage_protocol: Protocol of a stage served on a serial port; a manual stand by default.
    """
    from hil_mocks.practice_bench import (
        HandStage,
        PracticeBench,
        PracticeCommandError,
        PracticeConsole,
    )
    from hil_mocks.stages import SerialStage

    config = terminal.read_bench(bench or shipped_config("simulated.toml"), settings)
    serial_stage = None if stage_protocol is None else SerialStage(stage_protocol)
    stage: StageEmulator = serial_stage or HandStage(config.stage.limits_mm)
    practice = PracticeBench(config, height_mm=lambda: stage.true_height_mm, address=address)
    try:
        practice.place(target, orientation)
    except ValueError as error:
        raise BadParameter(str(error)) from error
    with ExitStack() as served:
        ended = served.enter_context(_ended_by_signals())
        if serial_stage is not None:
            served.enter_context(serial_stage)
        served.enter_context(practice)
        if terminal.wants_json():
            ready = {"camera_address": practice.camera.address, "stage_port": stage.port}
            typer.echo(json.dumps(ready))
        else:
            port = "no stage port" if stage.port is None else f"stage on {stage.port}"
            # A stand moved by hand goes as far as the bench file says; a controller has its own.
            limits_mm = config.stage.limits_mm if serial_stage is None else None
            opening = _opening(stage_protocol, practice.camera.address, stage.port, limits_mm)
            terminal.say(
                f"camera at {practice.camera.address}; {port}",
                f"open it with {opening}; Ctrl-C ends",
            )
        sys.stdout.flush()
        console = PracticeConsole(practice, stage)
        for line in _lines(ended):
            try:
                terminal.ERRORS.print(on_one_line(console.execute(line)), markup=False)
            except PracticeCommandError as error:
                terminal.say_error(error)


def _opening(
    protocol: StageProtocol | None,
    address: str,
    port: str | None,
    limits_mm: tuple[float, float] | None,
) -> str:
    """The options with which other commands open what is served."""
    bench = shipped_config("manta_g046.toml" if protocol is None else f"{protocol}_stage.toml")
    settings = [f"camera.address={address}"]
    if port is not None:
        settings.append(f"stage.port={port}")
    if limits_mm is not None:
        settings.append(f"stage.limits_mm=[{limits_mm[0]:g},{limits_mm[1]:g}]")
    return " ".join(["--bench", quote(str(bench)), *(f"--set {quote(one)}" for one in settings)])


@contextmanager
def _ended_by_signals() -> Iterator[socket.socket]:
    """Yield a socket that has something to read once Ctrl-C or SIGTERM came."""
    ended, wake = socket.socketpair()
    with ended, wake:
        wake.setblocking(False)
        kept = {
            number: signal.signal(number, lambda *_: None)
            for number in (signal.SIGINT, signal.SIGTERM)
        }
        kept_wake = signal.set_wakeup_fd(wake.fileno())
        try:
            yield ended
        finally:
            signal.set_wakeup_fd(kept_wake)
            for number, handler in kept.items():
                signal.signal(number, handler)


def _lines(ended: socket.socket) -> Iterator[str]:
    """Lines from the standard input until a signal; the end of the input ends nothing."""
    sources: list[int] = [ended.fileno(), sys.stdin.fileno()]
    rest = b""
    while True:
        ready, _, _ = select.select(sources, [], [])
        if sources[0] in ready:
            return
        read = os.read(sources[1], READ_BYTES)
        if not read:
            del sources[1]
            continue
        *lines, rest = (rest + read).split(b"\n")
        yield from (line.decode("utf-8", "replace") for line in lines if line.strip())
