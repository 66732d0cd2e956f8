"""``standoff guide``: any phone as the follow-up's camera, guided to the reference's pose."""

from __future__ import annotations

import json
import secrets
import sys
from collections import Counter
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import BadParameter, Option

from acquisition.files import require_folder
from analysis.choices import CurveObserver
from standoff import library, terminal
from standoff.errors import ApplicationError

if TYPE_CHECKING:
    from socket import socket

    from analysis.detectability import DetectabilityCurve
    from standoff.console.guide import ComparisonInputs, GuidedReference

DEFAULT_PORT = 8471
UNSPECIFIED = ("0.0.0.0", "::")  # noqa: S104 - refused

RECEIVE_BYTES = 512 * 1024
"""Lets 2 MB a second and more arrive over a link with a round trip of .1 s."""


_OF_CURVES = ("observer", "curve_noise_dn", "curve_contrast_dn", "focus_scatter_px2")


@terminal.command(*(terminal.needs(option, "curves") for option in _OF_CURVES))
def guide(
    reference: Path,
    *,
    out: Path = Path("guided"),
    psf: Path | None = None,
    noise: Path | None = None,
    curves: Path | None = None,
    min_dprime: Annotated[float, Option("--min-dprime")] = 2.0,
    port: Annotated[int, Option(min=0, max=65535)] = DEFAULT_PORT,
    host: str | None = None,
    observer: CurveObserver | None = None,
    curve_noise_dn: Annotated[float | None, Option("--curve-noise", metavar="S")] = None,
    curve_contrast_dn: Annotated[float | None, Option("--curve-contrast", metavar="C")] = None,
    focus_scatter_px2: terminal.FocusScatter = None,
) -> None:
    """Guide a phone to where a reference was taken, and list what changed, until Ctrl-C.

    Serves a page on the local network. A phone opens it by scanning the QR code in the
    terminal.

    Options
    -------
    reference: The earlier photograph, or a folder of several: one is then chosen by what the camera
        sees, or from a list.
    out: Folder for the photographs of the phone, each a capture session with its results.
    psf: psf.json of the phone's camera, for the comparison; without it the blur between the
        photographs is fitted.
    noise: noise.json of the phone's camera, for the comparison; without it the noise is fitted.
    curves: curves.json, to judge poses by d'; without it, d' follows from the PSF of the phone's
        own frames, once that has been measured during the approach.
    min_dprime: Lowest d' that is good enough.
    port: Port to listen on; 0 picks a free one.
    host: Address to listen on; by default this computer's address in the local network.
    observer: Use the curve for this observer.
    curve_noise_dn: Use the curve for this noise in DN.
    curve_contrast_dn: Use the curve for this contrast in DN.
    """
    if any(find_spec(name) is None for name in ("starlette", "uvicorn", "cryptography", "segno")):
        raise ApplicationError("the guide is not installed: pip install 'standoff[console]'")
    from standoff.console import is_loopback_host, open_socket, serve
    from standoff.console.guide import (
        ComparisonInputs,
        guide_app,
        made_certificate,
        network_address,
        qr_text,
    )

    require_folder(out)
    curve = None
    if curves is not None:
        choice = library.CurveChoice(
            observer=observer, noise_dn=curve_noise_dn, contrast_dn=curve_contrast_dn
        )
        curve = library.given_curve(curves, min_dprime, choice, focus_scatter_px2)
    inputs = ComparisonInputs(psf=psf, noise=noise)
    inputs.check()
    guided = _guided(reference, out, inputs, curve, min_dprime)
    address = host or network_address()
    if address is None:
        raise BadParameter(
            "this computer is not on any network that a phone could join; name the address with "
            "--host",
            param_hint="--host",
        )
    token = secrets.token_urlsafe(16)
    with open_socket(address, port, RECEIVE_BYTES) as bound:
        _refuse_unspecified(bound, address)
        certificate = made_certificate(address)
        shown = f"[{address}]" if ":" in address else address
        url = f"https://{shown}:{bound.getsockname()[1]}/"
        entry = f"{url}login?token={token}"

        def ready() -> None:
            if terminal.wants_json():
                document = {"url": url, "entry": entry, "fingerprint": certificate.fingerprint}
                typer.echo(json.dumps(document))
            else:
                terminal.say(qr_text(entry), *_how_to_pair(entry, certificate.fingerprint))
                reached = (
                    "this computer alone"
                    if is_loopback_host(address)
                    else "every device of the network that has the code"
                )
                terminal.say(f"Served to {reached}; photographs go to {out}; Ctrl-C ends.")
            sys.stdout.flush()

        app = guide_app(
            guided, token=token, fingerprint=certificate.fingerprint, tell=terminal.note
        )
        for one in guided:
            one.store.start()
        try:
            serve(app, bound, ready=ready, tls=certificate.context)
        finally:
            for one in guided:
                one.store.close()


def _refuse_unspecified(bound: socket, address: str) -> None:
    if bound.getsockname()[0] in UNSPECIFIED:
        raise BadParameter(
            f"{address} stands for all addresses of this computer, and no phone can open it; "
            "name the address on the phone's network",
            param_hint="--host",
        )


def _guided(
    reference: Path,
    out: Path,
    inputs: ComparisonInputs,
    curve: DetectabilityCurve | None,
    min_dprime: float,
) -> list[GuidedReference]:
    """Read a reference, or those in a folder, of which each has a folder for its photographs."""
    from acquisition.photographs import image_files_in
    from standoff.console.guide import GuidedReference, GuideReference, Judge, StillStore

    paths = image_files_in(reference) if reference.is_dir() else [reference]
    if not paths:
        raise ApplicationError(f"{reference}: the folder contains no image")
    twice = [stem for stem, count in Counter(path.stem for path in paths).items() if count > 1]
    if twice:
        raise ApplicationError(f"two references are named {twice[0]}; rename one of them")
    guided = []
    with terminal.ShownProgress().bar("reading references", len(paths)) as advance_to:
        for done, path in enumerate(paths, start=1):
            judge = Judge(GuideReference.read(path), curve, min_dprime)
            folder = out / path.stem if len(paths) > 1 else out
            guided.append(GuidedReference.of(judge, StillStore(folder, judge, lambda: inputs)))
            advance_to(done)
    return guided


def _how_to_pair(entry: str, fingerprint: str) -> tuple[str, ...]:
    return (
        f"Scan the code with the phone, or open {entry}",
        "The phone warns once about a certificate that it does not know: show the details and "
        "continue.",
        f"SHA-256 of the certificate: {fingerprint}",
    )
