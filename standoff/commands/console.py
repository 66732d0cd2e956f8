"""``standoff console``: the operator's web page for one bench."""

from __future__ import annotations

import json
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from urllib.parse import quote

import typer
from typer import BadParameter, Option

from acquisition.files import require_folder
from calibration.choices import DEFAULT_BOARD_TEXT
from standoff import terminal
from standoff.errors import ApplicationError
from standoff.shipped_configs import shipped_config

if TYPE_CHECKING:
    from acquisition.bench import BenchConfig
    from calibration.geometry import CharucoBoard
    from standoff.console import BenchHub, GivenCurves

DEFAULT_PORT = 8470


@terminal.command(*(terminal.needs(option, "bench") for option in ("plans", "board", "settings")))
def console(
    *,
    bench: Annotated[Path | None, Option("--bench")] = None,
    sessions: Path = Path("sessions"),
    plans: Annotated[list[Path] | None, Option(metavar="FOLDER")] = None,
    port: Annotated[int, Option(min=0, max=65535)] = DEFAULT_PORT,
    host: str = "127.0.0.1",
    token: Annotated[str | None, Option(envvar="STANDOFF_TOKEN")] = None,
    https: Annotated[bool, Option("--https")] = False,
    curves: Path | None = None,
    min_dprime: Annotated[float, Option("--min-dprime")] = 2.0,
    choice: terminal.Choice,
    board: Annotated[str, Option(metavar=terminal.BOARD_FORM)] = DEFAULT_BOARD_TEXT,
    settings: terminal.BenchKeys = None,
) -> None:
    """Serve the operator console as a web page on this computer, until Ctrl-C.

    With a bench file it controls the bench; closing the page changes nothing. Without one it is for
    photographs: they are dropped on its page or sent from a phone, imported, and compared.

    Options
    -------
    bench: Bench file (TOML); without it the console has no camera and no stage.
    sessions: Folder for capture sessions; created with the first one.
    plans: Folder of capture plans, in addition to the bench file's own; may be repeated. New plans
        are written to the first of these, or else to the folder plans within the folder of
        sessions.
    port: Port to listen on; 0 picks a free one.
    host: Address to listen on; other computers need --token.
    token: Secret for opening the console; safer in the environment than here.
    https: Encrypt connections, with a certificate made for this run. Other computers and phones
        need this to send photographs.
    curves: curves.json for judging the camera's pose.
    min_dprime: Lowest d' that is good enough.
    board: The ChArUco board for levelling the camera.
    """
    if any(find_spec(name) is None for name in ("starlette", "uvicorn", "websockets")):
        raise ApplicationError(
            "the console is not installed: pip install 'standoff[console]', or make setup"
        )
    from standoff.console import (
        MIN_TOKEN_CHARS,
        ConsoleHub,
        GivenCurves,
        is_loopback_host,
        open_socket,
        serve,
    )
    from standoff.console.web import console_app

    _refuse_open_door(host, token, MIN_TOKEN_CHARS, is_loopback=is_loopback_host(host))
    layout = terminal.charuco_board(board)
    for folder in (sessions, *(plans or ())):
        require_folder(folder)
    given = GivenCurves(path=curves, min_dprime=min_dprime, choice=choice)
    if bench is None:
        hub = ConsoleHub(sessions=sessions, curves=given)
    else:
        config = terminal.read_bench(bench, settings)
        folders = *(plans or (sessions / "plans",)), bench.parent
        hub = _bench_hub(config, sessions, folders, given, layout)
    certificate = None
    if https:
        from standoff.console.guide import made_certificate, qr_text

        certificate = made_certificate(host)
    with open_socket(host, port) as bound:
        shown = f"[{host}]" if ":" in host else host
        url = f"http{'s' * https}://{shown}:{bound.getsockname()[1]}/"
        entry = url if token is None else f"{url}login?token={quote(token)}"

        def ready() -> None:
            if terminal.wants_json():
                typer.echo(json.dumps({"url": url}))
            else:
                terminal.say(f"console at {entry}; Ctrl-C ends")
                if certificate is not None:
                    if token is not None:
                        terminal.say(qr_text(entry))
                    terminal.say(f"SHA-256 of the certificate: {certificate.fingerprint}")
                elif token is not None:
                    terminal.note(
                        "the connection is not encrypted: use it only on a network that you trust, "
                        "or give --https"
                    )
            sys.stdout.flush()

        hub.start()
        try:
            tls = None if certificate is None else certificate.context
            serve(console_app(hub, token=token), bound, ready=ready, tls=tls)
        finally:
            hub.close()


def _bench_hub(
    config: BenchConfig,
    sessions: Path,
    plan_folders: tuple[Path, ...],
    curves: GivenCurves,
    board: CharucoBoard,
) -> BenchHub:
    from standoff.console import BenchHub, bench_drivers

    return BenchHub(
        config,
        bench_drivers(config),
        sessions=sessions,
        plan_folders=(*plan_folders, shipped_config("demo_plan.toml").parent),
        curves=curves,
        board=board,
    )


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
