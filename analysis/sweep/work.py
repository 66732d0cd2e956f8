"""What is asked of photographs, and what a worker does with a batch of them."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar

from acquisition.printable import on_one_line
from analysis.errors import RefusedPhotographError
from analysis.sweep.items import SweepItem
from analysis.sweep.segments import Batch, Record, Stored, Written, writer_for

Commit = Callable[[Sequence[Record]], None]


class SweepWork(ABC):
    """Answers a question about photographs, in any process: it is pickled.

    The same photograph must give the same bits wherever and whenever it is done.

    A folder of pairs is swept by one photograph of each, such as the follow-up: the work finds the
    other by its name, and says of what size and time that is if it may change.
    """

    is_merged: ClassVar[bool] = False
    """Whether records of several photographs have their bytes merged."""

    commits_each: ClassVar[bool] = False
    """Whether each photograph is committed on its own, as it takes long; else each batch."""

    @property
    @abstractmethod
    def key(self) -> str:
        """Settings as text: what was done with others is not found."""

    @property
    @abstractmethod
    def state(self) -> Path:
        """Absolute path of the folder of the records, which exists and every worker sees."""

    @property
    def root(self) -> Path:
        """Folder that the files of records lie in."""
        return self.state

    def state_of(self, item: SweepItem) -> str:
        """Say on what else the answer for a photograph depends, as ASCII text."""
        return ""

    def answer(self, item: SweepItem, batch: Batch, commit: Commit) -> Record:
        """Answer for one photograph; ``commit`` takes what must not be lost meanwhile.

        A RefusedPhotographError or ValueError refuses it. A work that does whole batches has none.
        """
        raise NotImplementedError

    def merged(self, parts: Sequence[Stored]) -> bytes:
        """Return the bytes of several records together."""
        raise NotImplementedError

    def do(self, batch: Batch, commit: Commit) -> None:
        """Answer for the photographs of a batch, and commit what they gave."""
        records = []
        for item in batch.items:
            if item.hash in batch.overwritten:
                # A kill among the files must not leave the earlier answer.
                commit([Record(items=(item,), rows=({},), is_final=False)])
            records.append(self.answer_or_refusal(item, batch, commit))
            if self.commits_each:
                commit(records)
                records = []
        if records:
            commit(records)

    def answer_or_refusal(self, item: SweepItem, batch: Batch, commit: Commit) -> Record:
        """Answer for one photograph, or say why it gives nothing."""
        try:
            return self.answer(item, batch, commit)
        except (RefusedPhotographError, ValueError) as error:
            return refusal(item, error)


def refusal(item: SweepItem, error: Exception) -> Record:
    """Return the record of a photograph that gave nothing.

    One that could not be read, though it is there, is tried again by a later run.
    """
    is_unread = isinstance(error, RefusedPhotographError) and error.is_unread
    name, text = on_one_line(item.path), on_one_line(error)
    line = text if name in text else f"{name}: {text}"
    return Record(
        items=(item,), rows=({},), refused=line, is_final=not (is_unread and item.is_there)
    )


def do_batch(work: SweepWork, batch: Batch) -> list[Written]:
    """Do a batch in this process; return where its records are."""
    written: list[Written] = []
    writer = writer_for(work.state, batch.run)
    work.do(batch, lambda records: written.extend(writer.append(batch.digests, records)))
    return written
