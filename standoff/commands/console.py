"""``standoff console``: the operator's web page for one bench."""

from __future__ import annotations

import json as json_format
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

import typer
from typer import BadParameter, Option

from acquisition.files import require_folder
from calibration.choices import DEFAULT_BOARD_TEXT
from standoff import terminal
from standoff.errors import ApplicationError
from standoff.shipped_configs import shipped_config

DEFAULT_PORT = 8470


def console(
    *,
    bench: terminal.BenchFile,
    sessions: Annotated[
        Path, Option(help="Folder for capture sessions; created with the first one.")
    ] = Path("sessions"),
    plans: Annotated[
        list[Path] | None,
        Option(
            metavar="FOLDER",
            help="Folder of capture plans, besides the bench file's; may be repeated. New plans "
            "are written to the first, or to plans in the folder of sessions.",
        ),
    ] = None,
    port: Annotated[
        int, Option(min=0, max=65535, help="Port to listen on; 0 picks a free one.")
    ] = DEFAULT_PORT,
    host: Annotated[
        str, Option(help="Address to listen on; other computers need --token.")
    ] = "127.0.0.1",
    token: Annotated[
        str | None,
        Option(
            envvar="STANDOFF_TOKEN",
            help="Secret for opening the console; safer in the environment than here.",
        ),
    ] = None,
    curves: Annotated[
        Path | None, Option(help="curves.json for judging the camera's pose.")
    ] = None,
    min_dprime: Annotated[
        float, Option("--min-dprime", help="Lowest d' that is good enough.")
    ] = 2.0,
    model: terminal.CurveModel = None,
    observer: terminal.CurveObserver = None,
    noise: terminal.CurveNoise = None,
    contrast: terminal.CurveContrast = None,
    board: Annotated[
        str,
        Option(
            metavar="COLSxROWS:SQUARE_MM:MARKER_MM[:DICTIONARY]",
            help="The ChArUco board for levelling the camera.",
        ),
    ] = DEFAULT_BOARD_TEXT,
    settings: terminal.BenchKeys = None,
    json: terminal.Json = False,
) -> None:
    """Serve the operator console as a web page on this computer, until Ctrl-C.

    Closing the page changes nothing: the bench is controlled from here.
    """
    if any(find_spec(name) is None for name in ("starlette", "uvicorn", "websockets")):
        raise ApplicationError(
            "the console needs its extra: pip install 'standoff[console]', or make setup"
        )
    from standoff.console import (
        MIN_TOKEN_CHARS,
        BenchHub,
        GivenCurves,
        bench_drivers,
        is_loopback_host,
        open_socket,
        serve,
    )
    from standoff.console.web import console_app

    _refuse_open_door(host, token, MIN_TOKEN_CHARS, is_loopback=is_loopback_host(host))
    layout = terminal.charuco_board(board)
    for folder in (sessions, *(plans or ())):
        require_folder(folder)
    config = terminal.read_bench(bench, settings)
    choice = terminal.curve_choice(model, observer, noise, contrast)
    hub = BenchHub(
        config,
        bench_drivers(config),
        sessions=sessions,
        plan_folders=(
            *(plans or (sessions / "plans",)),
            bench.parent,
            shipped_config("demo_plan.toml").parent,
        ),
        curves=GivenCurves(path=curves, min_dprime=min_dprime, choice=choice),
        board=layout,
    )
    with open_socket(host, port) as bound:
        shown = f"[{host}]" if ":" in host else host
        url = f"http://{shown}:{bound.getsockname()[1]}/"
        entry = url if token is None else f"{url}login?token={quote(token)}"

        def ready() -> None:
            if json:
                typer.echo(json_format.dumps({"url": url}))
            else:
                terminal.say(f"console at {entry}; Ctrl-C ends")
                if token is not None:
                    terminal.note(
                        "the connection is not encrypted: use it only on a network that you trust"
                    )
            sys.stdout.flush()

        hub.start()
        try:
            serve(console_app(hub, token=token), bound, ready=ready)
        finally:
            hub.close()


def _refuse_open_door(host: str, token: str | None, least_chars: int, *, is_loopback: bool) -> None:
    if token is None and not is_loopback:
        raise BadParameter(
            f"other computers can reach {host}: give --token (or set the environment variable "
            "STANDOFF_TOKEN)",
            param_hint="--host",
        )
    if token is not None and len(token) < least_chars:
        raise BadParameter(
            f"a token must have at least {least_chars} characters", param_hint="--token"
        )
