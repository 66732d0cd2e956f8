"""The guide served by TLS on this computer, in this process."""

import asyncio
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Thread

from standoff.console.guide import (
    Certificate,
    GuidedReference,
    GuideReference,
    Judge,
    StillStore,
    guide_app,
    made_certificate,
)
from standoff.console.server import open_socket, server_of
from tests.standoff.console.hub_fixtures import wait_for

TOKEN = "a token that is long enough"


@dataclass(frozen=True, kw_only=True)
class ServedGuide:
    """Its address, and what it is made of."""

    url: str
    certificate: Certificate
    store: StillStore
    told: list[str]

    @property
    def entry(self) -> str:
        """The address in the QR code."""
        return f"{self.url}login?token={TOKEN.replace(' ', '%20')}"


@contextmanager
def served_guide(reference: Path, folder: Path, *others: Path) -> Iterator[ServedGuide]:
    """Serve one reference, or several; the store is that of the first."""
    guided = []
    for path in (reference, *others):
        judge = Judge(GuideReference.read(path))
        store = StillStore(folder / path.stem, judge)
        guided.append(GuidedReference.of(judge, store))
    certificate = made_certificate("127.0.0.1")
    told: list[str] = []
    fingerprint = certificate.fingerprint
    app = guide_app(guided, token=TOKEN, fingerprint=fingerprint, tell=told.append)
    server = server_of(app, certificate.context)
    for one in guided:
        one.store.start()
    with open_socket("127.0.0.1", 0) as bound:
        thread = Thread(target=lambda: asyncio.run(server.serve(sockets=[bound])))
        thread.start()
        try:
            wait_for(lambda: server.started, "the server")
            url = f"https://127.0.0.1:{bound.getsockname()[1]}/"
            yield ServedGuide(url=url, certificate=certificate, store=guided[0].store, told=told)
        finally:
            server.should_exit = True
            thread.join()
            for one in guided:
                one.store.close()


def trusting() -> ssl.SSLContext:
    """A context as of a phone on which the certificate was accepted."""
    context = ssl.create_default_context()
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context
