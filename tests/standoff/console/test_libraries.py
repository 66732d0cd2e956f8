"""Sessions that are read again only when they have changed, and snapshots."""

import json
import os
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import tifffile

from acquisition.devices import DeviceInfo
from acquisition.photographs import read_photograph
from acquisition.session import SessionNotes
from acquisition.session._reader import Session
from standoff.console.session_library import SessionLibrary, UnknownSessionError
from standoff.console.snapshot_library import (
    SnapshotLibrary,
    SnapshotRecord,
    identity_of,
    settings_of_record,
    snapshot_bytes,
    utc_text,
)
from standoff.errors import ApplicationError
from tests.acquisition.fakes import SETTINGS
from tests.acquisition.session_fixtures import add, writer


class CountingLibrary(SessionLibrary):
    """Notes which sessions are read."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.opened: list[str] = []

    def open(self, name: str) -> Session:
        self.opened.append(name)
        return super().open(name)


@pytest.fixture
def library(tmp_path: Path) -> CountingLibrary:
    for name in ("one", "two"):
        capture(tmp_path / name, name)
    return CountingLibrary(tmp_path)


def capture(session: Path, prefix: str) -> None:
    with writer(session, prefix=prefix) as opened:
        add(opened, opened.pending_entries()[0])


def test_sessions_that_have_not_changed_are_listed_without_being_read_again(
    library: CountingLibrary,
) -> None:
    first = library.summaries()
    assert sorted(library.opened) == ["one", "two"]
    assert library.summaries() == first
    assert len(library.opened) == 2


def test_the_session_that_has_changed_is_read_again_and_no_other(library: CountingLibrary) -> None:
    library.summaries()
    library.opened.clear()
    capture(library.folder / "two", "later")
    SessionNotes(library.folder / "two", operator="Ada").exclude(0, "dust")
    found = {each.name: (each.captured, each.excluded) for each in library.summaries()}
    assert found == {"one": (1, 0), "two": (2, 1)}
    assert library.opened == ["two"]


def test_a_session_that_is_put_back_from_a_copy_of_the_same_size_is_read_again(
    library: CountingLibrary,
) -> None:
    manifest = library.folder / "one" / "session.json"
    library.summaries()
    at_ns = manifest.stat().st_mtime_ns
    manifest.write_text(manifest.read_text().replace("Zoë", "Eöz"))
    os.utime(manifest, ns=(at_ns, at_ns + 1_000_000))
    assert {each.operator for each in library.summaries()} == {"Zoë", "Eöz"}


def test_a_damaged_session_is_told_until_it_is_mended(library: CountingLibrary) -> None:
    journal = library.folder / "one" / "journal.jsonl"
    sound = journal.read_bytes()
    journal.write_bytes(sound[:-40])
    assert [bool(each.fault) for each in library.summaries()].count(True) == 1
    journal.write_bytes(sound)
    assert not any(each.fault for each in library.summaries())


def test_whoever_turns_the_pages_of_a_session_reads_its_journal_once(
    library: CountingLibrary,
) -> None:
    session = library.read("one")
    assert library.read("one") is session
    assert library.opened == ["one"]


def test_a_page_of_a_session_that_goes_on_shows_what_was_added(library: CountingLibrary) -> None:
    assert len(library.read("one").captures) == 1
    capture(library.folder / "one", "later")
    assert len(library.read("one").captures) == 2
    assert len(library.read("two").captures) == 1
    assert library.opened == ["one", "one", "two"]


def test_a_session_that_was_removed_is_gone(library: CountingLibrary) -> None:
    library.summaries()
    library.read("one")
    (library.folder / "one").rename(library.folder / ".removed")
    assert [each.name for each in library.summaries()] == ["two"]
    with pytest.raises(UnknownSessionError):
        library.read("one")


TAKEN = datetime(2025, 3, 4, 5, 6, 7, 891_234, tzinfo=UTC)
INFO = DeviceInfo(vendor="Ähren", model="M", serial_number="7", firmware="1", driver="aravis")


def record(frames: int = 1) -> SnapshotRecord:
    return SnapshotRecord(
        taken_utc=utc_text(TAKEN),
        operator="Ada",
        frames=frames,
        height_mm=300.0,
        region_px=(1, 2, 30, 40),
        camera=identity_of(INFO),
        **settings_of_record(SETTINGS),
    )


def test_a_snapshot_is_read_with_its_levels_and_its_record(tmp_path: Path) -> None:
    levels_dn = np.random.default_rng(1).integers(0, 4096, (37, 53)).astype(np.uint16)
    library = SnapshotLibrary(tmp_path / "snapshots")
    name = library.save(snapshot_bytes(levels_dn, record()), TAKEN)
    assert library.latest == name
    path = tmp_path / "snapshots" / name
    photograph = read_photograph(path)
    assert photograph.encoding.is_linear
    np.testing.assert_array_equal(photograph.stored, levels_dn)
    with tifffile.TiffFile(path) as tiff:
        page = tiff.pages.first
        assert (page.bitspersample, len(tiff.pages)) == (16, 1)
        document = json.loads(page.description)
    assert document == {
        "schema": "standoff.snapshot/1",
        "taken_utc": "2025-03-04T05:06:07.891Z",
        "operator": "Ada",
        "frames": 1,
        "exposure_us": 2000.0,
        "gain_db": 0.0,
        "black_level_dn": 64.0,
        "max_level_dn": 4095,
        "pixel_format": "Mono12",
        "frame_rate_hz": 50.0,
        "height_mm": 300.0,
        "region_px": [1, 2, 30, 40],
        "camera": {
            "vendor": "Ähren",
            "model": "M",
            "serial_number": "7",
            "firmware": "1",
            "driver": "aravis",
        },
    }
    assert SnapshotRecord.model_validate(document) == record()


def test_a_mean_keeps_its_fractions(tmp_path: Path) -> None:
    levels_dn = np.array([[100.1, 200.7], [0.0, 4095.0]], dtype=np.float32)
    library = SnapshotLibrary(tmp_path)
    name = library.save(snapshot_bytes(levels_dn, record(10)), TAKEN)
    np.testing.assert_array_equal(read_photograph(tmp_path / name).stored, levels_dn)


def test_snapshots_of_one_second_do_not_replace_each_other(tmp_path: Path) -> None:
    library = SnapshotLibrary(tmp_path)
    data = [snapshot_bytes(np.full((2, 2), at, dtype=np.uint16), record()) for at in range(3)]
    names = [library.save(each, TAKEN) for each in data]
    assert len(set(names)) == 3
    assert [library.read(name) for name in names] == [bytes(each) for each in data]


@pytest.mark.parametrize("name", ["", "..", "../secret.tif", "x.tif", "2025-03-04 05.06.07.tif\n"])
def test_no_other_file_is_read(tmp_path: Path, name: str) -> None:
    (tmp_path / "secret.tif").write_bytes(b"secret")
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "x.tif").write_bytes(b"other")
    assert SnapshotLibrary(tmp_path / "s").read(name) is None


def test_links_are_not_followed(tmp_path: Path) -> None:
    name = "2025-03-04 05.06.07.tif"
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "file").write_bytes(b"secret")
    (tmp_path / "real" / name).symlink_to("file")
    assert SnapshotLibrary(tmp_path / "real").read(name) is None
    (tmp_path / "real" / name).unlink()
    (tmp_path / "real" / name).write_bytes(b"secret")
    (tmp_path / "linked").symlink_to("real")
    assert SnapshotLibrary(tmp_path / "linked").read(name) is None


def test_a_folder_that_cannot_be_written_is_an_error_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ApplicationError, match="cannot create the folder"):
        SnapshotLibrary(tmp_path / "file").save(memoryview(b""), TAKEN)


@pytest.mark.parametrize("name", ["snapshots", "Snapshots", "photographs"])
def test_no_session_has_the_name_of_the_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(UnknownSessionError, match="none of snapshots"):
        SessionLibrary(tmp_path).path_for(name)
