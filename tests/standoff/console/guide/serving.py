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
    ComparisonInputs,
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
def served_guide(reference: Path, folder: Path) -> Iterator[ServedGuide]:
    judge = Judge(GuideReference.read(reference))
    store = StillStore(folder, judge, ComparisonInputs())
    certificate = made_certificate("127.0.0.1")
    told: list[str] = []
    app = guide_app(
        store, judge, token=TOKEN, fingerprint=certificate.fingerprint, tell=told.append
    )
    server = server_of(app, certificate.context)
    store.start()
    with open_socket("127.0.0.1", 0) as bound:
        thread = Thread(target=lambda: asyncio.run(server.serve(sockets=[bound])))
        thread.start()
        try:
            wait_for(lambda: server.started, "the server")
            url = f"https://127.0.0.1:{bound.getsockname()[1]}/"
            yield ServedGuide(url=url, certificate=certificate, store=store, told=told)
        finally:
            server.should_exit = True
            thread.join()
            store.close()


def trusting() -> ssl.SSLContext:
    """A context as of a phone on which the certificate was accepted."""
    context = ssl.create_default_context()
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context
