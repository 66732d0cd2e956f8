"""Stills become sessions with a pose, a verdict and changes; hostile ones are refused in words."""

import hashlib
import io
import json
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from PIL import Image, ImageOps

import standoff
from acquisition.errors import ImageFileError, SessionError
from analysis.errors import AnalysisError
from standoff.console.guide import GuideReference, Judge, StillStore
from standoff.console.guide._reference import UprightView, upright
from standoff.console.guide._stills import StillRecord
from tests.standoff.console.guide.scenes import SIZE, Stills
from tests.standoff.console.hub_fixtures import wait_for

pytestmark = pytest.mark.slow


@pytest.fixture
def store(stills: Stills, tmp_path: Path) -> StillStore:
    judge = Judge(GuideReference.read(stills.reference))
    return StillStore(tmp_path / "guided", judge)


def arrived(store: StillStore, data: bytes) -> Path:
    sha256 = hashlib.sha256(data).hexdigest()
    store.uploads.begin(sha256, len(data))
    path = store.uploads.add(sha256, 0, data, len(data)).path
    assert path is not None
    return path


def processed(store: StillStore, data: bytes, *, is_location_removed: bool = False) -> StillRecord:
    return store.process(arrived(store, data), is_location_removed=is_location_removed)


def test_a_still_becomes_a_session_with_its_pose_and_its_changes(
    store: StillStore, stills: Stills
) -> None:
    data = stills.again.read_bytes()
    record = processed(store, data)
    session = store.folder / record.name
    assert record.state == "done"
    assert record.pose is not None
    assert record.pose["verdict"] == "go"
    assert record.pose["pose"]["distance"] == pytest.approx(1.01, abs=0.003)
    assert (session / "results" / "photograph.jpg").read_bytes() == data
    assert standoff.verify_session(session).is_ok
    captured = standoff.Session(session)
    assert len(captured.records) == 1
    notes = json.dumps(captured.to_json())
    assert hashlib.sha256(data).hexdigest() in notes
    assert "pose: go" in notes
    # The one change of the fixture: 16 x 16 of 800 x 600 px, 8 px right and 48 px below the middle.
    change = record.changes[0]
    assert change["side"] == "brighter"
    assert change["x"] == pytest.approx(0.5 + 48 / 727 - 0.0096, abs=0.01)
    assert change["y"] == pytest.approx(0.5 + 48 / 545, abs=0.01)
    for name in ("before.jpg", "after.jpg"):
        picture = store.picture(record.name, name)
        assert picture is not None
        assert Image.open(io.BytesIO(picture)).size == SIZE
    assert (session / "results" / "changes" / "changes.json").is_file()
    assert store.uploads.whole() == []


def test_what_is_known_survives_a_restart(store: StillStore, stills: Stills) -> None:
    record = processed(store, stills.again.read_bytes())
    judge = Judge(GuideReference.read(stills.reference))
    again = StillStore(store.folder, judge)
    kept = json.loads(json.dumps([one.to_json() for one in again.records()]))
    assert kept == json.loads(json.dumps([record.to_json()]))
    assert again.record_of(record.sha256) is not None


@pytest.mark.usefixtures("not_compared")
def test_another_scene_is_kept_and_said_not_to_be_the_reference(
    store: StillStore, stills: Stills
) -> None:
    record = processed(store, stills.other.read_bytes())
    assert record.state == "failed"
    assert record.pose is not None
    assert record.pose["verdict"] == "no go"
    assert standoff.verify_session(store.folder / record.name).is_ok


@pytest.fixture
def not_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AnalysisError("not compared here")

    monkeypatch.setattr("standoff.console.guide._stills.find_changes", refuse)


@pytest.mark.usefixtures("not_compared")
def test_a_comparison_that_an_earlier_run_did_not_finish_is_made(
    store: StillStore, stills: Stills, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store, "_finish", lambda record: record)  # killed meanwhile
    record = processed(store, stills.again.read_bytes())
    assert record.state == "comparing"
    (found,) = worked(restarted(store))
    assert found.state == "failed"
    assert "not compared here" in found.words


def restarted(store: StillStore) -> StillStore:
    return StillStore(store.folder, store._judge)


def worked(store: StillStore) -> list[StillRecord]:
    """What is known once nothing waits any more."""
    store.start()
    wait_for(lambda: all(one.state in ("done", "failed") for one in store.records()), "the stills")
    store.close()
    store._thread.join()
    return store.records()


@pytest.mark.usefixtures("not_compared")
def test_a_still_that_cannot_be_stored_is_kept_for_the_next_run(
    store: StillStore, stills: Stills, monkeypatch: pytest.MonkeyPatch
) -> None:
    def is_full(*_: object, **__: object) -> None:
        raise SessionError("no space left on the disk")

    path = arrived(store, stills.again.read_bytes())
    with monkeypatch.context() as patched:
        patched.setattr("standoff.console.guide._stills.import_photographs", is_full)
        store.take(path, is_location_removed=False)
        (record,) = worked(store)
    assert record.state == "failed"
    assert "no space left" in record.words
    assert "next run" in record.words
    assert store.uploads.whole() == [path]
    assert store.record_of(path.name) == record  # it need not be sent again
    again = restarted(store)
    (record,) = worked(again)
    assert record.pose is not None
    assert again.uploads.whole() == []
    assert (store.folder / record.name / "results" / "photograph.jpg").is_file()


@pytest.mark.usefixtures("not_compared")
def test_a_still_that_ends_in_an_unexpected_error_does_not_end_the_others(
    store: StillStore, stills: Stills, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = arrived(store, stills.other.read_bytes())
    second = arrived(store, stills.again.read_bytes())
    real = StillStore._store

    def stored(self: StillStore, path: Path, *rest: object, **named: object) -> None:
        if path == first:
            raise MemoryError("too large")
        real(self, path, *rest, **named)  # type: ignore[arg-type]  # as it was called

    monkeypatch.setattr(StillStore, "_store", stored)
    for path in (first, second):
        store.take(path, is_location_removed=False)
    found = {record.sha256: record for record in worked(store)}
    assert found[first.name].state == "failed"
    assert "MemoryError: too large" in found[first.name].words
    assert found[second.name].pose is not None
    assert store.uploads.whole() == [first]


@pytest.mark.usefixtures("not_compared")
def test_a_still_is_taken_once_however_often_it_is_reported_whole(
    store: StillStore, stills: Stills, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = arrived(store, stills.again.read_bytes())
    taken = [store.take(path, is_location_removed=False) for _ in range(3)]
    assert taken[0] == taken[1] == taken[2]
    assert store._queue.qsize() == 1
    # After a restart it is known before the worker has come to it.
    again = restarted(store)
    monkeypatch.setattr(again, "_run", lambda: None)
    again._thread = Thread(target=again._run)
    again.start()
    assert again.record_of(path.name) is not None
    again.take(path, is_location_removed=False)
    assert again._queue.qsize() == 1


def test_a_still_that_is_none_is_refused_before_the_phone_is_told_that_it_is_stored(
    store: StillStore,
) -> None:
    path = arrived(store, bomb())
    with pytest.raises(ImageFileError, match="lower resolution"):
        store.take(path, is_location_removed=False)
    assert store.records() == []
    assert store.uploads.whole() == []


@pytest.mark.parametrize(
    "damage",
    [
        {"reference": None},
        {"state": "lost"},
        {"pose": {"words": "no verdict"}},
        {"changes": [{"x": 0.5}]},
        {"changes": [1]},
        {"better": [1]},
        {"better": ["x" * 2**20]},
        {"sha256": ...},
    ],
)
def test_a_damaged_document_is_passed_over(store: StillStore, damage: dict[str, object]) -> None:
    good = StillRecord(name="one", reference="reference.jpg", sha256="0" * 64, state="done")
    document = good.to_json() | damage
    kept = {name: value for name, value in document.items() if value is not ...}
    for name, written in (("one", good.to_json()), ("two", kept)):
        folder = store.folder / name / "results"
        folder.mkdir(parents=True)
        (folder / "guide.json").write_text(json.dumps(written))
    assert [record.name for record in restarted(store).records()] == ["one"]


@pytest.mark.usefixtures("not_compared")
def test_the_location_is_removed_where_that_was_asked_for(
    store: StillStore, stills: Stills
) -> None:
    image = Image.open(stills.other)
    exif = Image.Exif()
    exif[0x010F] = "Maker"
    exif.get_ifd(0x8825)[2] = (51.0, 28.0, 40.0)
    made = io.BytesIO()
    image.save(made, "JPEG", exif=exif)
    for is_removed, data in ((True, made.getvalue()), (False, made.getvalue() + b"\0")):
        record = processed(store, data, is_location_removed=is_removed)
        path = store.folder / record.name / "results" / "photograph.jpg"
        kept = Image.open(io.BytesIO(path.read_bytes())).getexif()
        assert (0x8825 in kept) is not is_removed
        assert kept[0x010F] == "Maker"


@pytest.mark.usefixtures("not_compared")
def test_a_dark_still_is_said_to_need_light(store: StillStore, stills: Stills) -> None:
    dark = np.asarray(Image.open(stills.again)) // 12
    made = io.BytesIO()
    Image.fromarray(dark).save(made, "JPEG", quality=98)
    record = processed(store, made.getvalue())
    assert record.pose is not None
    assert record.pose["verdict"] != "go"
    assert "more light" in record.pose["remedy"]


def bomb() -> bytes:
    made = io.BytesIO()
    Image.new("L", (64, 64)).save(made, "JPEG")
    data = bytearray(made.getvalue())
    at = data.index(b"\xff\xc0") + 5
    data[at : at + 4] = (60_000).to_bytes(2, "big") * 2
    return bytes(data)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"no photograph", "not a JPEG file"),
        (bomb(), "lower resolution"),
        (b"\xff\xd8\xff", "JPEG"),
    ],
)
def test_what_is_no_photograph_is_refused_in_words_and_leaves_nothing(
    store: StillStore, data: bytes, words: str
) -> None:
    record = processed(store, data)
    assert record.state == "failed"
    assert words in record.words
    assert [path.name for path in store.folder.iterdir()] == ["incoming"]
    assert store.uploads.whole() == []


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_photograph_is_judged_the_way_up_it_is_viewed(
    orientation: int, stills: Stills, tmp_path: Path
) -> None:
    viewed = np.asarray(Image.open(stills.reference))
    # As Pillow, which turns the stored pixels by the tag, is undone by its own inverse.
    inverse = {6: 8, 8: 6}.get(orientation, orientation)
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / "turned.jpg"
    Image.fromarray(upright(viewed, inverse)).save(path, quality=95, exif=exif)
    view = UprightView.of(standoff.read_image(path))
    plain = UprightView.of(standoff.read_image(stills.reference))
    assert view.size == plain.size
    assert np.abs(view.levels.astype(float) - plain.levels).mean() < 3
    with Image.open(path) as opened:
        shown = ImageOps.exif_transpose(opened)
    assert np.abs(np.asarray(shown, float) - viewed).mean() < 3
