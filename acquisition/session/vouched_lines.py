"""Which lines of a damaged journal are still those that were written."""

import hashlib
import io
from dataclasses import dataclass

from acquisition.session.journal_chain import ChainedLine, chain_after
from acquisition.session.journal_event import JournalEvent


@dataclass(frozen=True, slots=True, kw_only=True)
class LostLine:
    """A line that was not taken over; its text is empty if it is gone."""

    number: int
    text: str = ""


def vouched_lines(data: bytes, counted: int) -> tuple[list[JournalEvent], list[LostLine]]:
    """Take a damaged journal apart: events that can be vouched for, in order, and what is lost.

    A chained line is vouched for by its chain after that of the line before it, stated or computed.
    Where the line before it is gone, its text alone speaks for it. Lines that were moved come back
    to their places. Of lines without a chain, those that parse are taken over.

    Parameters
    ----------
    data
        Bytes of the journal.
    counted
        Number of lines that the journal had, as far as it is known.
    """
    unchained: list[JournalEvent] = []
    links = _Links()
    odd: list[tuple[int, bytes]] = []
    for place, line in enumerate(io.BytesIO(data).readlines(), start=1):
        link = ChainedLine.parse(line)
        event = None if link is not None or links.by_number else _event(line)
        if link is not None and link.number is not None:
            links.by_number.setdefault(link.number, []).append(link)
        elif event is not None:
            unchained.append(event)
            links.unchained_bytes += line
        else:
            odd.append((place, line))
    kept, seen = list(unchained), set(range(1, len(unchained) + 1))
    lost: dict[int, str] = {}
    for number in sorted(links.by_number):
        every = links.by_number[number]
        found = [link for link in every if links.is_vouched_for(link, number, len(unchained) + 1)]
        event = _event(found[0].text) if found else None
        if event is None:
            lost[number] = _text(every[0].text)
        else:
            kept.append(event)
            seen.add(number)
    for place, line in odd:
        free = place if place not in seen | lost.keys() else max([*seen, *lost]) + 1
        lost[free] = _text(line)
    for number in range(1, max([counted, *links.by_number, 0]) + 1):
        if number not in seen:
            lost.setdefault(number, "")
    return kept, [LostLine(number=number, text=lost[number]) for number in sorted(lost)]


class _Links:
    """Chained lines by the number that they had when they were written."""

    def __init__(self) -> None:
        self.by_number: dict[int, list[ChainedLine]] = {}
        self.unchained_bytes = b""

    def is_vouched_for(self, link: ChainedLine, number: int, first: int) -> bool:
        """Whether a line, of which the first one has the number ``first``, is as it was written."""
        before = self._chains_before(number, first)
        if before is None:
            return True
        computed = {chain_after(chain, link.text) for chain in before}
        # Its own chain may be what was damaged: then the next line's fits the one computed.
        return link.chain in computed or any(
            chain_after(chain, after.text) == after.chain
            for chain in computed
            for after in self.by_number.get(number + 1, ())
        )

    def _chains_before(self, number: int, first: int) -> set[str] | None:
        """Chains that the line before may have had, stated and computed; None if it is gone."""
        if number == first:
            return {hashlib.sha256(self.unchained_bytes).hexdigest()}
        lines = self.by_number.get(number - 1)
        if lines is None:
            return None
        earlier = {line.chain for line in self.by_number.get(number - 2, ())}
        if number - 1 == first:
            earlier = {hashlib.sha256(self.unchained_bytes).hexdigest()}
        stated = {line.chain for line in lines}
        return stated | {chain_after(chain, line.text) for chain in earlier for line in lines}


def _text(line: bytes) -> str:
    return line.decode(errors="backslashreplace").rstrip("\n")


def _event(text: bytes) -> JournalEvent | None:
    try:
        return JournalEvent.from_line(text)
    except ValueError:
        return None
