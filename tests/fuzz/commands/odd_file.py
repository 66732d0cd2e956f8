"""A file that no command should be given, or that is damaged; each is made where it is read."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from random import Random

Made = Callable[[Path], object]


@dataclass(frozen=True, slots=True, kw_only=True)
class OddFile:
    """One case.

    ``kind`` is what is wrong with it, shared by similar cases. ``make`` puts it at a path.
    ``is_refused`` says that no command may take it for a sound file. ``is_chained_anew`` marks a
    journal whose chain vouches for it: a capture that it does not name does not exist, and the next
    run may take it again.
    """

    kind: str
    name: str
    make: Made
    is_refused: bool = False
    is_chained_anew: bool = False


def of_bytes(kind: str, name: str, data: bytes, *, is_refused: bool = False) -> OddFile:
    """A case of these bytes."""
    return OddFile(
        kind=kind, name=name, make=lambda path: path.write_bytes(data), is_refused=is_refused
    )


def made_of(kind: str, name: str, data: Callable[[], bytes]) -> OddFile:
    """A case of the bytes that this returns."""
    return OddFile(kind=kind, name=name, make=lambda path: path.write_bytes(data()))


def cut_short(kind: str, name: str, data: bytes, count: int) -> Iterator[OddFile]:
    """A sound file that ends too early, at ``count`` places."""
    for part in range(count):
        end = part * len(data) // count
        yield of_bytes(f"{kind} cut short", f"{name} of {end} bytes", data[:end])


def with_flipped_bits(kind: str, name: str, data: bytes, count: int) -> Iterator[OddFile]:
    """A sound file with one to eight wrong bits, ``count`` times; heads suffer most."""
    for number in range(count):
        random = Random(f"{name} {number}")
        damaged = bytearray(data)
        for _ in range(1 << random.randrange(4)):
            end = len(data) if random.random() < 0.5 else min(len(data), 256)
            damaged[random.randrange(end)] ^= 1 << random.randrange(8)
        yield of_bytes(f"{kind} with flipped bits", f"{name}, draw {number}", bytes(damaged))
