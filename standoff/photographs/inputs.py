"""The files that one command reads, remembered for the provenance of what it writes."""

from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path

from acquisition.printable import on_one_line
from acquisition.session import JOURNAL_NAME, Session
from calibration.provenance import InputFile, Provenance, utc_now
from simulation.arrays import FloatArray
from standoff import __version__
from standoff.photographs.guard import read_file
from standoff.photographs.photograph import Photograph, PhotographHead
from standoff.photographs.reader import ReadOptions, read_frames, read_image


class Inputs:
    """Reads photographs in one way, and keeps the list of all that was read.

    Parameters
    ----------
    options
        How photographs are read.
    announce
        Called with a sentence about the encoding taken, once for each kind of file, and about
        photographs that viewers turn.
    """

    def __init__(
        self,
        options: ReadOptions | None = None,
        announce: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.options = options or ReadOptions()
        self._announce = announce
        self._files: dict[str, str] = {}
        self._encodings: list[str] = []
        self._announced: set[str] = set()

    def photograph(self, path: Path) -> Photograph:
        """Read a photograph and list it.

        Raises
        ------
        ImageFileError
            If it cannot be read.
        """
        photograph = read_image(path, self.options)
        self._add_head(photograph)
        return photograph

    def frames(self, path: Path) -> Iterator[Photograph]:
        """Read every image of a file, one after the other, and list the file.

        Raises
        ------
        ImageFileError
            If it cannot be read.
        """
        for frame in read_frames(path, self.options):
            self._add_head(frame)
            yield frame

    def add_given(self, photograph: Photograph) -> None:
        """Say what there is to say of a photograph that no file holds."""
        self._say(photograph)

    def grey(self, path: Path) -> FloatArray:
        """Read the linear grey levels of a photograph, shape ``(rows, cols)``, and list it.

        Raises
        ------
        ImageFileError
            If it cannot be read, or is a raw mosaic, of which only ``calibrate`` measures planes.
        """
        return self.photograph(path).grey_dn

    def add(self, path: Path | None) -> None:
        """List a file that another reader reads: a PSF, curves, a table of noise.

        Raises
        ------
        ImageFileError
            If it is no regular file, or cannot be read.
        """
        if path is None:
            return
        self._list(path, sha256(read_file(path)).hexdigest(), None)

    def add_session(self, session: Session) -> None:
        """List a capture session by its journal, which holds the hashes of the captures."""
        self.add(session.path / JOURNAL_NAME)
        self._list_encoding("linear")

    def announce(self, sentence: str) -> None:
        """Say what another process found out about photographs."""
        self._announce(sentence)

    def add_known(self, path: str, sha256: str, encoding: str | None) -> None:
        """List a file whose hash and encoding another process found out."""
        self._list(Path(path), sha256, encoding)

    def provenance(self, command: str) -> Provenance:
        """Return the provenance of what is made from all that has been read."""
        return Provenance(
            version=__version__,
            created=utc_now(),
            command=on_one_line(command),
            inputs=tuple(
                InputFile(path=path, sha256=digest) for path, digest in self._files.items()
            ),
            encoding=self._encodings[0] if len(self._encodings) == 1 else tuple(self._encodings),
        )

    def _add_head(self, head: PhotographHead) -> None:
        if head.sha256 is not None:
            self._list(head.path, head.sha256, head.encoding.name)
        self._say(head)

    def _list(self, path: Path, digest: str, encoding: str | None) -> None:
        self._files[on_one_line(path)] = digest
        if encoding is not None:
            self._list_encoding(encoding)

    def _list_encoding(self, encoding: str) -> None:
        if encoding not in self._encodings:
            self._encodings.append(encoding)

    def _say(self, photograph: PhotographHead) -> None:
        for kind, sentence in photograph.remarks.items():
            if kind not in self._announced:
                self._announced.add(kind)
                self._announce(sentence)
