"""References that were chosen in the console: read when asked for, and a few of them kept."""

from collections.abc import Iterator, Mapping
from hashlib import sha256
from pathlib import Path
from threading import Lock

from acquisition.session import CaptureRecord
from analysis.detectability import DetectabilityCurve
from standoff.console.guide._application import GuidedReference
from standoff.console.guide._assessment import Judge
from standoff.console.guide._reference import GuideReference
from standoff.console.guide._stills import ComparisonInputs, StillStore
from standoff.console.photographs import photograph_file
from standoff.library import RESULTS_FOLDER

MOST_CHOSEN = 8
"""References that are ready at one time; the one chosen first is forgotten for one more."""


class ReferenceShelf(Mapping[str, GuidedReference]):
    """Photographs of sessions that a camera is guided back to, by name.

    Their stills become sessions in the folder ``sessions``; what arrives waits in ``incoming``.
    """

    def __init__(self, sessions: Path, incoming: Path) -> None:
        self._sessions = sessions
        self._incoming = incoming
        self._lock = Lock()
        self._chosen: dict[str, GuidedReference] = {}

    def __getitem__(self, name: str) -> GuidedReference:
        return self._chosen[name]

    def __iter__(self) -> Iterator[str]:
        return iter(list(self._chosen))

    def __len__(self) -> int:
        return len(self._chosen)

    def choose(
        self,
        session: Path,
        record: CaptureRecord,
        curve: DetectabilityCurve | None = None,
        min_d_prime: float = 2.0,
    ) -> str:
        """Make a photograph a reference, and return its name; with a curve, poses have its d'.

        One that is chosen again is judged by the curve of now. The PSF of a comparison is the one
        that the session has then.
        """
        name = f"{record.target} of {session.name}"
        with self._lock:
            if name in self._chosen:
                self._chosen[name].judge.use(curve, min_d_prime)
                return name
            reference = GuideReference.read(photograph_file(session, record), name)
            psf = session / RESULTS_FOLDER / "psf.json"
            judge = Judge(reference, curve, min_d_prime)
            key = sha256(name.encode("utf-8", "replace")).hexdigest()[:16]
            made = GuidedReference.of(
                judge,
                StillStore(
                    self._sessions,
                    judge,
                    lambda: ComparisonInputs(psf=psf if psf.is_file() else None),
                    self._incoming / key,
                ),
            )
            made.store.start()
            self._chosen[reference.name] = made
            if len(self._chosen) > MOST_CHOSEN:
                self._chosen.pop(next(iter(self._chosen))).store.close()
            return reference.name

    def close(self) -> None:
        """Begin no other still."""
        with self._lock:
            for one in self._chosen.values():
                one.store.close()
