"""What is fuzzed: a reader, what it is given, and the errors it may raise."""

import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from hypothesis import HealthCheck, given, settings
from hypothesis.strategies import SearchStrategy


@dataclass(frozen=True, slots=True)
class FuzzTarget:
    """A reader of bytes; whatever is not ``documented`` is a crash."""

    name: str
    data: SearchStrategy[bytes]
    read: Callable[[bytes], object]
    documented: tuple[type[Exception], ...]
    examples: int = 60

    def run(self, data: bytes) -> None:
        """Read once."""
        with warnings.catch_warnings(), suppress(*self.documented):
            # A library may warn of damage that it can live with.
            warnings.simplefilter("ignore", UserWarning)
            self.read(data)

    def search(self, examples: int | None = None) -> None:
        """Read that many inputs; raises what is not documented, with the input it found."""
        checks = (HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example)

        @settings(
            max_examples=examples or self.examples, deadline=None, suppress_health_check=checks
        )
        @given(self.data)
        def reads(data: bytes) -> None:
            self.run(data)

        reads()


def from_file(
    read: Callable[[Path], object], name: str, *beside: tuple[str, bytes]
) -> Callable[[bytes], object]:
    """Read the bytes from a file of that name, with other files beside it."""

    def read_bytes(data: bytes) -> object:
        with TemporaryDirectory() as folder:
            for other, content in beside:
                (Path(folder) / other).write_bytes(content)
            path = Path(folder) / name
            path.write_bytes(data)
            return read(path)

    return read_bytes
