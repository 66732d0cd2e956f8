"""Stills become sessions with a pose, a verdict and changes; hostile ones are refused in words."""

import hashlib
import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageOps

import standoff
from analysis.errors import AnalysisError
from standoff.console.guide import ComparisonInputs, GuideReference, Judge, StillStore
from standoff.console.guide._reference import UprightView, upright
from standoff.console.guide._stills import StillRecord
from tests.standoff.console.guide.scenes import SIZE, Stills

pytestmark = pytest.mark.slow


@pytest.fixture
def store(stills: Stills, tmp_path: Path) -> StillStore:
    judge = Judge(GuideReference.read(stills.reference))
    return StillStore(tmp_path / "guided", judge, ComparisonInputs())


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
    again = StillStore(store.folder, judge, ComparisonInputs())
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
    again = StillStore(store.folder, store._judge, ComparisonInputs())
    again.start()
    again.close()
    again._thread.join()
    (found,) = again.records()
    assert found.state == "failed"
    assert "not compared here" in found.words


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
