"""Photographs in parts: whole and verified, or not at all."""

import hashlib
import os
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from standoff.console.photographs._uploads import (
    LEAST_FREE_BYTES,
    MOST_BYTES,
    MOST_WAITING,
    STALE_IN_THE_WAY_S,
    STALE_S,
    TryAgainError,
    UploadError,
    Uploads,
)

DATA = bytes(range(256)) * 5
SHA = hashlib.sha256(DATA).hexdigest()


@pytest.fixture
def uploads(tmp_path: Path) -> Uploads:
    return Uploads(tmp_path / "incoming")


def test_parts_in_order_become_the_photograph(uploads: Uploads) -> None:
    assert uploads.begin(SHA, len(DATA)).received == 0
    assert uploads.add(SHA, 0, DATA[:500], len(DATA)).path is None
    found = uploads.add(SHA, 500, DATA[500:], len(DATA))
    assert found.path is not None
    assert found.path.read_bytes() == DATA
    assert uploads.whole() == [found.path]


def test_one_that_is_whole_is_not_asked_for_again(uploads: Uploads) -> None:
    uploads.begin(SHA, len(DATA))
    whole = uploads.add(SHA, 0, DATA, len(DATA))
    # The answer was lost: the phone asks again, or repeats the last part.
    assert uploads.begin(SHA, len(DATA)) == whole
    assert uploads.add(SHA, 0, DATA, len(DATA)) == whole
    assert whole.received == len(DATA)
    assert len(uploads.whole()) == 1


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=25)
@given(st.lists(st.integers(1, 400), min_size=1), st.data())
def test_a_link_that_breaks_and_repeats_changes_nothing(
    tmp_path: Path, sizes: list[int], data: st.DataObject
) -> None:
    folder = tmp_path / str(len(list(tmp_path.iterdir())))
    sent, found = 0, None
    while sent < len(DATA):
        uploads = Uploads(folder)  # as after a restart
        sent = uploads.begin(SHA, len(DATA)).received
        size = data.draw(st.sampled_from(sizes))
        found = uploads.add(SHA, sent, DATA[sent : sent + size], len(DATA))
        if found.path is None:
            # The answer was lost: the same part comes again, and is not added twice.
            again = uploads.add(SHA, sent, DATA[sent : sent + size], len(DATA))
            assert again.received == found.received
        sent = found.received
    assert found is not None
    assert found.path is not None
    assert found.path.read_bytes() == DATA


def test_a_photograph_that_arrives_otherwise_is_thrown_away(uploads: Uploads) -> None:
    uploads.begin(SHA, len(DATA))
    with pytest.raises(TryAgainError, match="send it again"):
        uploads.add(SHA, 0, DATA[:-1] + b"x", len(DATA))
    assert uploads.whole() == []
    assert uploads.begin(SHA, len(DATA)).received == 0


@pytest.mark.parametrize("name", ["", "a" * 63, "../" * 21 + "a", "A" * 64, "g" * 64])
def test_a_name_that_is_no_hash_leads_nowhere(uploads: Uploads, name: str) -> None:
    with pytest.raises(UploadError, match="SHA-256"):
        uploads.begin(name, 1)
    with pytest.raises(UploadError, match="SHA-256"):
        uploads.add(name, 0, b"x", 1)


@pytest.mark.parametrize("size", [0, MOST_BYTES + 1])
def test_a_size_out_of_range_is_refused(uploads: Uploads, size: int) -> None:
    with pytest.raises(UploadError, match="64 MB"):
        uploads.begin(SHA, size)


def test_more_than_was_announced_is_refused(uploads: Uploads) -> None:
    uploads.begin(SHA, 10)
    with pytest.raises(UploadError, match="more was sent"):
        uploads.add(SHA, 0, DATA, 10)


def test_what_was_not_announced_is_refused(uploads: Uploads) -> None:
    with pytest.raises(TryAgainError, match="not announced"):
        uploads.add(SHA, 0, DATA, len(DATA))


def test_only_so_many_are_on_their_way(uploads: Uploads) -> None:
    for number in range(MOST_WAITING):
        uploads.begin(f"{number:064x}", 1)
    with pytest.raises(TryAgainError, match="wait until one is done"):
        uploads.begin(SHA, len(DATA))
    assert uploads.begin(f"{3:064x}", 1).received == 0  # one that is known goes on


def test_one_that_nobody_goes_on_with_is_not_in_the_way_for_a_week(
    uploads: Uploads, tmp_path: Path
) -> None:
    for number in range(MOST_WAITING):
        uploads.begin(f"{number:064x}", 1)
    old_s = time.time() - STALE_IN_THE_WAY_S - 60
    os.utime(tmp_path / "incoming" / f"{0:064x}.part", (old_s, old_s))
    assert uploads.begin(SHA, len(DATA)).received == 0
    assert not (tmp_path / "incoming" / f"{0:064x}.part").exists()


def test_no_photograph_is_begun_on_a_disk_that_is_nearly_full(
    uploads: Uploads, monkeypatch: pytest.MonkeyPatch
) -> None:
    uploads.begin(SHA, len(DATA))
    free = SimpleNamespace(free=LEAST_FREE_BYTES - 1)
    monkeypatch.setattr("shutil.disk_usage", lambda _: free)
    with pytest.raises(TryAgainError, match="disk is full"):
        uploads.begin("0" * 64, 1)
    assert uploads.begin(SHA, len(DATA)).received == 0  # one that is known goes on


def test_a_photograph_that_was_given_up_makes_room(uploads: Uploads, tmp_path: Path) -> None:
    for number in range(MOST_WAITING):
        uploads.begin(f"{number:064x}", 1)
    old_s = time.time() - STALE_S - 60
    os.utime(tmp_path / "incoming" / f"{0:064x}.part", (old_s, old_s))
    assert uploads.begin(SHA, len(DATA)).received == 0
    assert len(list((tmp_path / "incoming").iterdir())) == MOST_WAITING
