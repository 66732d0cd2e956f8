"""Whatever is lost of a session: no capture is written over, and what is not whole is told.

All subsets of the journal's lines, its head, session.json and the captures are taken away, and the
journal is torn at bytes all over its last two lines: next to their ends at every one, at every
seventh between them; test_journal.py cuts it at every one. The truth is the session as captured.
"""

import os
from collections.abc import Iterator
from itertools import accumulate, product
from pathlib import Path

import pytest

from acquisition.errors import SessionError
from acquisition.session._files import JOURNAL_NAME
from acquisition.session._journal import HEAD_NAME
from acquisition.session._reader import verify
from acquisition.session._repair import repair_session
from tests.acquisition.session_fixtures import add, plan_of, writer

PLAN = plan_of(heights_mm=[100.0], targets=[{"kind": "flat", "target": "paper"}], repeats=2)

Files = dict[str, bytes]


@pytest.fixture
def whole(tmp_path: Path) -> Files:
    """The files of a session of two captures."""
    path = tmp_path / "whole"
    with writer(path, plan=PLAN) as session:
        for entry in session.entries:
            add(session, entry, 1000.0 + entry.index)
    assert verify(path).is_ok
    return files_of(path)


@pytest.fixture(autouse=True)
def _no_waiting_for_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "fsync", lambda _: None)


def files_of(path: Path) -> Files:
    return {
        file.relative_to(path).as_posix(): file.read_bytes()
        for file in path.rglob("*")
        if file.is_file()
    }


def is_capture(name: str) -> bool:
    return name.startswith("captures/")


def restore(path: Path, files: Files) -> None:
    for folder in (path, path / "captures", path / "frames", path / "logs"):
        folder.mkdir(exist_ok=True)
        for file in folder.iterdir():
            if file.is_file():
                file.unlink()
    for name, data in files.items():
        (path / name).write_bytes(data)


def losses(whole: Files) -> Iterator[Files]:
    """Every choice of what is left of lines, head, session.json and captures."""
    lines = whole[JOURNAL_NAME].splitlines(keepends=True)
    others = [name for name in whole if name != JOURNAL_NAME]
    for kept in product((True, False), repeat=len(lines) + len(others)):
        files = {
            name: whole[name]
            for name, is_kept in zip(others, kept[len(lines) :], strict=True)
            if is_kept
        }
        files[JOURNAL_NAME] = b"".join(
            line for line, is_kept in zip(lines, kept, strict=False) if is_kept
        )
        yield files


def torn(whole: Files) -> Iterator[Files]:
    """The journal cut off within its last two lines, with and without its head."""
    journal = whole[JOURNAL_NAME]
    *_, start, middle, last = accumulate(map(len, journal.splitlines(keepends=True)))
    near = {end for line in (start, middle, last) for end in range(line - 4, line + 4)}
    for end in sorted((near | {*range(start, last, 7)}) & {*range(start, last)}):
        files = {**whole, JOURNAL_NAME: journal[:end]}
        yield files
        yield {name: data for name, data in files.items() if name != HEAD_NAME}


def verified(path: Path) -> bool:
    try:
        return verify(path).is_ok
    except SessionError:
        return False


def run(path: Path) -> None:
    """Capture what is pending, where that is not refused."""
    try:
        with writer(path, plan=PLAN, prefix="later") as session:
            for entry in session.pending_entries():
                add(session, entry, 2000.0)
    except SessionError:
        pass


def assert_nothing_is_written_over(
    path: Path, files: Files, whole: Files, *, repaired: bool = True
) -> None:
    restore(path, files)
    is_whole = (
        files.keys() == whole.keys()
        and files[JOURNAL_NAME].rstrip() == whole[JOURNAL_NAME].rstrip()
    )
    assert verified(path) == is_whole
    run(path)
    captures = {name: data for name, data in files.items() if is_capture(name)}
    for name, data in captures.items():
        assert (path / name).read_bytes() == data
    if "session.json" not in files or not repaired:
        return
    # After a repair and another run the session is whole again, and holds what was left of it.
    restore(path, files)
    repair_session(path)
    run(path)
    assert verified(path)
    assert set(captures.values()) <= set(files_of(path).values())


@pytest.mark.slow
def test_no_loss_of_lines_and_files_costs_a_capture_or_passes_verify(
    tmp_path: Path, whole: Files
) -> None:
    assert len([*losses(whole)]) == 2 ** (4 + 4)  # start, plan, two captures; four other files
    for files in losses(whole):
        assert_nothing_is_written_over(tmp_path / "after", files, whole)


@pytest.mark.slow
def test_no_torn_journal_costs_a_capture_or_passes_verify(tmp_path: Path, whole: Files) -> None:
    for number, files in enumerate(torn(whole)):
        is_fourth = number % 8 < 2  # with and without the head
        assert_nothing_is_written_over(tmp_path / "after", files, whole, repaired=is_fourth)
