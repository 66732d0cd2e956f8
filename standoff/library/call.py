"""One call of the library: what it reads, what it has to say, and how far it is."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from os import PathLike
from pathlib import Path
from typing import Protocol

from acquisition.photographs import Inputs, Photograph, ReadOptions
from acquisition.printable import on_one_line
from acquisition.provenance import Provenance
from acquisition.session import Session
from analysis.design_cache import keep_designs_on_disk
from standoff.compile_notice import announce_compiling
from standoff.library.caller import caller
from standoff.library.inputs import ImageLike, path_of, photograph, with_white_level


class Progress(Protocol):
    """Shows how far a call is; ``docs/library.md`` fits it to tqdm and to rich.

    Examples
    --------
    >>> from contextlib import contextmanager
    >>> class Counted:
    ...     @contextmanager
    ...     def bar(self, task, total):
    ...         print(task)
    ...         yield lambda done: None
    ...
    ...     def note(self, text):
    ...         print(text)
    >>> geometry = standoff.calibrate_geometry("board", progress=Counted())
    matching captures
    the scale comes from the board 11x8:12:9:4X4_50; --board names another
    """

    def bar(self, task: str, total: int) -> AbstractContextManager[Callable[[int], None]]:
        """Give a block a function that is called with the number of pieces done, of ``total``."""
        ...

    def note(self, text: str) -> None:
        """Take a remark at once, which stands among the ``notes`` of the result as well."""
        ...


class Silent:
    """The progress of a call that nobody watches."""

    def bar(self, task: str, total: int) -> AbstractContextManager[Callable[[int], None]]:
        """Show nothing."""
        return nullcontext(lambda _: None)

    def note(self, text: str) -> None:
        """Keep silent: the result has it."""


class Call:
    """What the parts of one public function share.

    Parameters
    ----------
    function
        Name of the public function, for the provenance.
    progress
        Who watches; nobody if None.
    reading
        How photographs are read.
    files
        Other arguments; the paths among them are listed in the provenance.
    white_level
        Level at which photographs are clipped, where it is stated.

    Raises
    ------
    ImageFileError
        If one of ``files`` cannot be read.
    """

    def __init__(
        self,
        function: str,
        progress: Progress | None = None,
        reading: ReadOptions | None = None,
        files: Iterable[object] = (),
        white_level: float | None = None,
    ) -> None:
        announce_compiling()
        keep_designs_on_disk()
        self._function = function
        self._progress = progress or Silent()
        self._notes: dict[str, None] = {}
        self.inputs = Inputs(with_white_level(reading, white_level), self.announce)
        for given in files:
            if isinstance(given, str | PathLike):
                self.inputs.add(Path(given))

    @property
    def notes(self) -> tuple[str, ...]:
        """Every remark so far, once each."""
        return tuple(self._notes)

    def note(self, text: str) -> None:
        """Make a remark, which whoever watches sees at once."""
        self.announce(text)
        self._progress.note(text)

    def announce(self, text: str) -> None:
        """Make a remark for the end, such as one about how a photograph was read."""
        self._notes[on_one_line(text)] = None

    def photograph(self, image: ImageLike, name: str = "image") -> Photograph:
        """Return an image with what is known of its levels; a file is listed.

        Raises
        ------
        TypeError
            If it is neither an array nor a path.
        ImageFileError
            If the file cannot be read, or the array is not a finite image.
        """
        if isinstance(image, str | PathLike):
            return self.inputs.photograph(path_of(image, name))
        found = photograph(image, name, self.inputs.options)
        if not isinstance(image, Photograph):
            self.inputs.add_given(found)
        return found

    @contextmanager
    def bar(self, task: str, total: int) -> Iterator[Callable[[int], None]]:
        """Give the block a function that shows how many of ``total`` pieces are done."""
        with self._progress.bar(task, total) as advance_to:
            yield advance_to

    def provenance(self) -> Provenance:
        """Return the provenance of what is made from all that has been read."""
        return self.inputs.provenance(caller(self._function))

    def provenance_of(self, session: Session | None, *files: Path | None) -> Provenance:
        """Return the provenance of what is made from a session, files, or both, and nothing else.

        Raises
        ------
        ImageFileError
            If a file cannot be read.
        """
        inputs = Inputs()
        if session is not None:
            inputs.add_session(session)
        for path in files:
            inputs.add(path)
        return inputs.provenance(caller(self._function))
