"""Photographs that arrive wait under their own names, and are imported as they were sent."""

import hashlib
import io
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import standoff
from acquisition.errors import ImageFileError, OperatorStopError
from acquisition.session import Session
from standoff.console.jobs import Job
from standoff.console.photographs import (
    ArrivedPhotograph,
    ImportRequest,
    PhotographInbox,
    TryAgainError,
    UploadError,
    import_arrived,
    photograph_file,
)
from standoff.errors import REPORTED_ERRORS, ApplicationError

GPS = 0x8825


def jpeg(seed: int = 1, *, has_place: bool = False) -> bytes:
    levels = np.random.default_rng(seed).integers(0, 255, (48, 64, 3), np.uint8)
    exif = Image.Exif()
    if has_place:
        exif.get_ifd(GPS)[2] = (51.0, 28.0, 40.0)
    made = io.BytesIO()
    Image.fromarray(levels).save(made, "JPEG", exif=exif)
    return made.getvalue()


def png(width: int, height: int) -> bytes:
    """A PNG of a size that is only said: one row of pixels."""

    def chunk(name: bytes, data: bytes) -> bytes:
        check = zlib.crc32(name + data)
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", check)

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    pixels = zlib.compress(bytes(width + 1))
    start = b"\x89PNG\r\n\x1a\n"
    return start + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def sent(
    inbox: PhotographInbox, data: bytes, name: str, *, is_location_removed: bool = False
) -> ArrivedPhotograph:
    """Send a photograph whole, as a page does."""
    sha256 = hashlib.sha256(data).hexdigest()
    inbox.begin(sha256, len(data), name)
    assert inbox.add(sha256, 0, data, len(data)).path is not None
    return inbox.receive(sha256, name, is_location_removed=is_location_removed)


@pytest.fixture
def inbox(tmp_path: Path) -> PhotographInbox:
    return PhotographInbox(tmp_path / "photographs")


def test_a_photograph_waits_as_it_was_sent_and_survives_a_restart(
    inbox: PhotographInbox, tmp_path: Path
) -> None:
    sent(inbox, jpeg(), "wall.jpg")
    (again,) = PhotographInbox(tmp_path / "photographs").arrived()
    assert again.path.read_bytes() == jpeg()
    assert (again.path.name, again.media_type) == ("wall.jpg", "image/jpeg")


def test_one_that_is_there_is_not_sent_again(inbox: PhotographInbox) -> None:
    one = sent(inbox, jpeg(), "wall.jpg")
    assert inbox.begin(one.sha256, len(jpeg()), "other.jpg").path == one.path
    assert inbox.add(one.sha256, 0, b"x", 1).path == one.path
    assert inbox.receive(one.sha256, "x.jpg", is_location_removed=False) == one
    assert inbox.arrived() == [one]


def test_two_of_one_name_get_different_ones(inbox: PhotographInbox) -> None:
    for seed, name in enumerate(["IMG_1.jpg", "img_1.JPG", "IMG_1.jpg"]):
        sent(inbox, jpeg(seed), name)
    names = [one.path.name for one in inbox.arrived()]
    assert sorted(names) == [
        "IMG_1 (3).jpg",
        "IMG_1.jpg",
        "img_1 (2).JPG",
    ]


def test_the_location_is_removed_on_request_and_nothing_else_is_changed(
    inbox: PhotographInbox,
) -> None:
    data = jpeg(has_place=True)
    one = sent(inbox, data, "wall.jpg", is_location_removed=True)
    kept = Image.open(one.path)
    assert dict(kept.getexif().get_ifd(GPS)) == {}
    np.testing.assert_array_equal(kept, Image.open(io.BytesIO(data)))
    assert one.sha256 == hashlib.sha256(data).hexdigest()
    with_place = sent(inbox, jpeg(2, has_place=True), "floor.jpg")
    again = sent(inbox, jpeg(2, has_place=True), "floor.jpg", is_location_removed=True)
    assert again.path == with_place.path
    assert dict(Image.open(io.BytesIO(again.path.read_bytes())).getexif().get_ifd(GPS)) == {}
    with pytest.raises(ImageFileError, match="only from JPEG files"):
        sent(inbox, png(8, 8), "wall.png", is_location_removed=True)


@pytest.mark.parametrize(
    ("data", "name", "said"),
    [
        (b"\x89PNG is this", "wall.jpg", "wall.jpg: it is not a JPEG"),
        (jpeg(), "wall.png", "wall.png: it is not a PNG"),
        (png(60_000, 60_000), "bomb.png", "60000 x 60000 px; at most 64 million"),
        (b"", "empty.jpg", "at most 64 MB"),
    ],
)
def test_what_is_not_what_its_name_says_or_too_large_is_refused_by_its_header(
    inbox: PhotographInbox, data: bytes, name: str, said: str
) -> None:
    with pytest.raises((ImageFileError, UploadError), match=said):
        sent(inbox, data, name)
    assert inbox.arrived() == []
    assert [path for path in inbox._folder.rglob("*") if path.is_file()] == []


@pytest.mark.parametrize(
    "name",
    [
        "../wall.jpg",
        "a/b.jpg",
        "C:\\wall.jpg",
        ".jpg",
        "-x.jpg",
        "wall\n.jpg",
        "wall\u202e.jpg",
        "w" * 200 + ".jpg",
        "wall.exe",
        "wall",
        "",
    ],
)
def test_a_name_that_leads_elsewhere_or_is_that_of_no_photograph_is_refused(
    inbox: PhotographInbox, name: str
) -> None:
    with pytest.raises(UploadError):
        inbox.begin("0" * 64, 10, name)


@pytest.mark.parametrize("name", ["IMG_1.HEIC", "wall.heif"])
def test_a_heic_photograph_is_refused_with_what_to_do(inbox: PhotographInbox, name: str) -> None:
    with pytest.raises(UploadError, match="HEIC photograph, which is not read; send it as JPEG"):
        inbox.begin("0" * 64, 10, name)


def test_a_screenshot_of_macos_arrives_with_plain_spaces(inbox: PhotographInbox) -> None:
    one = sent(inbox, png(8, 8), "Screenshot 2026-01-02 at 1.23.45\u202fPM.png")
    assert one.path.name == "Screenshot 2026-01-02 at 1.23.45 PM.png"


def test_more_than_can_wait_are_refused(
    inbox: PhotographInbox, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("standoff.console.photographs._inbox.MOST_ARRIVED", 1)
    one = sent(inbox, jpeg(), "wall.jpg")
    with pytest.raises(TryAgainError, match="1 photographs wait"):
        sent(inbox, jpeg(2), "other.jpg")
    inbox.discard(one.sha256)
    sent(inbox, jpeg(2), "other.jpg")


def test_nothing_is_written_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "photographs").symlink_to(tmp_path / "elsewhere")
    inbox = PhotographInbox(tmp_path / "photographs")
    with pytest.raises(UploadError, match="is a link"):
        inbox.begin("0" * 64, 10, "wall.jpg")
    assert inbox.arrived() == []


def imported(words: Sequence[str], _: Job) -> object:
    """What ``standoff import`` does."""
    at = list(words).index("--")
    options = dict(word.removeprefix("--").split("=", 1) for word in words[1:at])
    standoff.import_photographs(
        words[at + 1 :],
        options["out"],
        kind="texture",
        height_mm=float(options["height-mm"]),
        operator=options["operator"],
    )
    return {}


def request_for(inbox: PhotographInbox, session: Path) -> ImportRequest:
    return ImportRequest(
        session=session,
        photographs=tuple(inbox.arrived()),
        kind="texture",
        height_mm=250.0,
        operator="Ada",
    )


def test_an_import_makes_a_session_that_keeps_the_files_as_they_were_sent(
    inbox: PhotographInbox, tmp_path: Path
) -> None:
    datas = {name: jpeg(seed) for seed, name in enumerate(["after.jpg", "before.jpg"])}
    for name, data in datas.items():
        sent(inbox, data, name)
    done = import_arrived(inbox, request_for(inbox, tmp_path / "wall"), Job("import"), imported)
    assert done == "2 photographs imported."
    assert inbox.arrived() == []
    session = Session(tmp_path / "wall")
    assert {record.target for record in session.records} == set(datas)
    for record in session.records:
        assert record.height_mm == 250
        assert photograph_file(session.path, record).read_bytes() == datas[record.target]
    assert standoff.verify_session(session.path).is_ok
    notes = [event.facts["text"] for event in session.events if event.kind == "note"]
    assert all(hashlib.sha256(data).hexdigest() in " ".join(notes) for data in datas.values())


def test_an_import_that_fails_keeps_what_has_arrived_and_names_it_by_its_name(
    inbox: PhotographInbox, tmp_path: Path
) -> None:
    sent(inbox, jpeg()[:-400], "cut.jpg")

    def run(words: Sequence[str], job: Job) -> object:
        try:
            return imported(words, job)
        except REPORTED_ERRORS as error:
            raise ApplicationError(str(error)) from error

    with pytest.raises(ApplicationError, match=r"^cut\.jpg: "):
        import_arrived(inbox, request_for(inbox, tmp_path / "wall"), Job("import"), run)
    assert [one.path.name for one in inbox.arrived()] == ["cut.jpg"]


def test_an_import_that_is_cancelled_leaves_no_session_and_can_be_made_again(
    inbox: PhotographInbox, tmp_path: Path
) -> None:
    sent(inbox, jpeg(), "wall.jpg")
    session = tmp_path / "wall"

    def run(words: Sequence[str], job: Job) -> object:
        imported(words, job)  # what it had written when it was cancelled
        raise OperatorStopError

    with pytest.raises(OperatorStopError):
        import_arrived(inbox, request_for(inbox, session), Job("import"), run)
    assert not session.exists()
    import_arrived(inbox, request_for(inbox, session), Job("import"), imported)
    assert [path.name for path in inbox._folder.iterdir() if any(path.rglob("*.*"))] == []
    assert standoff.verify_session(session).is_ok


def test_one_that_is_thrown_away_while_it_is_imported_is_imported_and_not_kept(
    inbox: PhotographInbox, tmp_path: Path
) -> None:
    for seed, name in enumerate(["a.jpg", "b.jpg"]):
        sent(inbox, jpeg(seed), name)
    request = request_for(inbox, tmp_path / "wall")

    def run(words: Sequence[str], job: Job) -> object:
        imported(words, job)
        inbox.discard(request.photographs[0].sha256)
        return {}

    import_arrived(inbox, request, Job("import"), run)
    first, second = Session(tmp_path / "wall").records
    assert photograph_file(tmp_path / "wall", first) == tmp_path / "wall" / first.file
    assert photograph_file(tmp_path / "wall", second).read_bytes() == jpeg(1)


def test_the_journal_says_what_is_kept_of_one_whose_location_was_removed(
    inbox: PhotographInbox, tmp_path: Path
) -> None:
    one = sent(inbox, jpeg(has_place=True), "wall.jpg", is_location_removed=True)
    import_arrived(inbox, request_for(inbox, tmp_path / "wall"), Job("import"), imported)
    session = Session(tmp_path / "wall")
    kept = photograph_file(session.path, session.records[0]).read_bytes()
    (note,) = [str(event.facts["text"]) for event in session.events if event.kind == "note"]
    assert one.sha256 in note
    assert f"without its location as SHA-256 {hashlib.sha256(kept).hexdigest()}" in note


def test_a_link_in_a_session_is_not_taken_for_the_photograph(
    inbox: PhotographInbox, tmp_path: Path
) -> None:
    sent(inbox, jpeg(), "wall.jpg")
    import_arrived(inbox, request_for(inbox, tmp_path / "wall"), Job("import"), imported)
    (record,) = Session(tmp_path / "wall").records
    kept = photograph_file(tmp_path / "wall", record)
    kept.rename(tmp_path / "elsewhere.jpg")
    kept.symlink_to(tmp_path / "elsewhere.jpg")
    assert photograph_file(tmp_path / "wall", record) == tmp_path / "wall" / record.file
