import errno
import hashlib
import json
import os
import shutil
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from acquisition.bench import BenchConfig
from acquisition.errors import SessionError
from acquisition.session._journal import HEAD_NAME
from acquisition.session._reader import Session, verify
from acquisition.session._record import Photograph
from acquisition.session._repair import repair_session
from acquisition.session._writer import SessionWriter
from tests.acquisition.journals import cut_last_line
from tests.acquisition.session_fixtures import (
    DEVICES,
    add,
    bench_of,
    plan_of,
    whole_session,
    writer,
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "new" / "session"


def kinds(path: Path) -> list[str]:
    return [event.kind for event in Session(path).events]


def test_a_new_session_begins_with_start_and_plan(path: Path) -> None:
    with writer(path) as session:
        assert session.pending_entries() == session.entries
    start, plan = Session(path).events
    assert (start.kind, plan.kind) == ("start", "plan")
    digest = hashlib.sha256((path / "session.json").read_bytes()).hexdigest()
    assert start.facts["session_sha256"] == digest
    assert start.facts["devices"] == DEVICES
    assert plan.facts == {"name": "small", "captures": 6}


def test_an_empty_directory_becomes_a_session(path: Path) -> None:
    path.mkdir(parents=True)
    writer(path).close()
    assert kinds(path) == ["start", "plan"]


def test_a_session_that_was_killed_while_being_made_can_be_made(path: Path) -> None:
    path.mkdir(parents=True)
    (path / "journal.jsonl").touch()
    (path / "session.json.part").write_bytes(b'{"sch')
    writer(path).close()
    assert kinds(path) == ["start", "plan"]


def test_a_session_that_was_killed_before_its_start_was_journaled_starts(path: Path) -> None:
    writer(path).close()
    manifest = (path / "session.json").read_bytes()
    (path / "journal.jsonl").write_bytes(b"")
    (path / HEAD_NAME).unlink()
    writer(path).close()
    assert kinds(path) == ["start", "plan"]
    assert (path / "session.json").read_bytes() == manifest
    assert verify(path).is_ok


def test_a_directory_with_other_files_is_left_alone(path: Path) -> None:
    path.mkdir(parents=True)
    (path / "holiday.jpg").touch()
    with pytest.raises(SessionError) as refused:
        writer(path)
    assert refused.value.fault == "not a session"
    assert [file.name for file in path.iterdir()] == ["holiday.jpg"]


def test_a_session_whose_session_json_is_gone_is_not_begun_anew(path: Path) -> None:
    whole_session(path)
    (path / "session.json").unlink()
    with pytest.raises(SessionError) as refused:
        writer(path)
    assert refused.value.fault == "not a session"
    for folder in ("captures", "frames", "logs"):
        shutil.rmtree(path / folder)
    with pytest.raises(SessionError) as refused:
        writer(path)
    assert refused.value.fault == "damaged"


def test_resuming_asks_only_for_what_is_missing_or_damaged(path: Path) -> None:
    with writer(path) as session:
        records = [add(session, entry) for entry in session.entries[:4]]
    damaged = path / records[1].file
    damaged.write_bytes(damaged.read_bytes()[:-1])
    (path / records[2].file).unlink()
    with writer(path, prefix="later") as session:
        assert [entry.index for entry in session.pending_entries()] == [1, 2, 4, 5]
    assert Session(path).events[-1].facts["pending"] == 4
    assert kinds(path)[-1] == "resume"


def test_a_capture_whose_journal_line_was_cut_short_is_taken_in(path: Path) -> None:
    records = whole_session(path)
    cut_last_line(path / "journal.jsonl", 2)
    (unknown,) = [check.file for check in verify(path).files if check.state != "ok"]
    assert unknown == records[-1].file
    with writer(path, prefix="later") as session:
        assert session.pending_entries() == ()
    assert Session(path).records == records
    assert verify(path).is_ok
    assert kinds(path)[-4:] == ["note", "capture", "note", "resume"]


def killed_after(path: Path, files: int) -> list[str]:
    """A run with raw frames that was killed when the second capture had so many of its files."""
    frames = (np.full((4, 5), 7, np.uint16),) * 3
    with writer(path) as session:
        add(session, session.entries[0], raw_frames=frames)
        record = add(session, session.entries[1], raw_frames=frames)
    cut_last_line(path / "journal.jsonl", 2)
    names = [str(record.frames_file), record.file]
    for name in names[files:]:
        (path / name).unlink()
    return names


def test_a_kill_between_a_capture_and_its_line_loses_nothing(path: Path) -> None:
    names = killed_after(path, 2)
    with writer(path, prefix="later") as session:
        assert [entry.index for entry in session.pending_entries()] == [2, 3, 4, 5]
    assert verify(path).is_ok
    assert names[1] in [record.file for record in Session(path).records]


def test_raw_frames_without_their_capture_are_set_aside(path: Path) -> None:
    names = killed_after(path, 1)
    frames = (path / names[0]).read_bytes()
    with writer(path, prefix="later") as session:
        assert session.pending_entries()[0].index == 1
        add(session, session.entries[1], raw_frames=(np.full((4, 5), 8, np.uint16),) * 3)
    assert verify(path).is_ok
    assert [file.read_bytes() for file in (path / "set-aside").iterdir()] == [frames]


def test_more_than_a_kill_leaves_is_refused_and_nothing_is_written(path: Path) -> None:
    whole_session(path)
    for file in (path / "captures").glob("0004*"):
        (path / "captures" / "0004_other.tif").write_bytes(file.read_bytes())
    before = {file: file.read_bytes() for file in path.rglob("*") if file.is_file()}
    with pytest.raises(SessionError) as refused:
        writer(path)
    assert refused.value.fault == "unknown files"
    assert "captures/0004_other.tif" in str(refused.value)
    assert {file: file.read_bytes() for file in path.rglob("*") if file.is_file()} == before


def test_a_capture_that_appears_during_a_run_is_not_written_over(path: Path) -> None:
    with writer(path) as session:
        entry = session.entries[0]
        there = path / "captures" / f"{entry.stem}.tif"
        there.write_bytes(b"from somebody else")
        with pytest.raises(SessionError) as refused:
            add(session, entry)
    assert refused.value.fault == "unknown files"
    assert there.read_bytes() == b"from somebody else"


@pytest.mark.parametrize(
    ("changed", "key"),
    [
        ({"bench": bench_of(gain_db=3.0)}, "bench.camera.gain_db"),
        ({"plan": plan_of(heights_mm=[100.0, 111.0])}, "plan.heights_mm.1"),
        ({"plan": plan_of(repeats=2)}, "plan.repeats"),
        (
            {"devices": {**DEVICES, "camera": {"DeviceSerialNumber": "C2"}}},
            "devices.camera.DeviceSerialNumber",
        ),
        ({"devices": {}}, "devices.camera"),
    ],
)
def test_another_plan_bench_or_device_is_refused_with_the_difference_in_one_line(
    path: Path, changed: dict[str, object], key: str
) -> None:
    whole_session(path)
    before = (path / "journal.jsonl").read_bytes()
    with pytest.raises(SessionError) as caught:
        writer(path, **changed)  # type: ignore[arg-type]
    assert caught.value.fault == "made otherwise"
    assert key in caught.value.keys
    assert "\n" not in str(caught.value)
    assert (path / "journal.jsonl").read_bytes() == before
    writer(path).close()  # the lock was given back


@pytest.mark.parametrize(
    ("role", "changed", "key"),
    [
        ("camera", {"Width": 390}, "devices.camera.Width"),
        ("stage", {"limits_mm": [0.0, 200.0]}, "devices.stage.limits_mm.1"),
        ("stage", {"DeviceSerialNumber": "S2"}, "devices.stage.DeviceSerialNumber"),
    ],
)
def test_another_sensor_travel_or_serial_number_is_refused(
    path: Path, role: str, changed: dict[str, object], key: str
) -> None:
    devices = {
        "camera": {**DEVICES["camera"], "Width": 780, "Height": 580},
        "stage": {**DEVICES["stage"], "limits_mm": [0.0, 300.0]},
    }
    writer(path, devices=devices).close()
    with pytest.raises(SessionError) as refused:
        writer(path, devices={**devices, role: {**devices[role], **changed}})
    assert refused.value.keys == (key,)
    # A session of an older version does not tell them all.
    writer(path, devices=DEVICES).close()


def test_a_device_that_is_plugged_in_elsewhere_is_the_same_and_noted(path: Path) -> None:
    def bench(port: str, address: str) -> BenchConfig:
        made = bench_of()
        stage = made.stage.model_copy(update={"port": port})
        camera = made.camera.model_copy(update={"address": address})
        return made.model_copy(update={"stage": stage, "camera": camera})

    writer(path, bench=bench("/dev/ttyUSB0", "192.168.7.20")).close()
    writer(path, bench=bench("/dev/ttyUSB1", "192.168.7.21")).close()
    note = Session(path).events[-1]
    assert note.kind == "note"
    assert "bench.stage.port" in note.facts["text"]
    assert "ttyUSB1" in note.facts["text"]
    assert "192.168.7.21" in note.facts["text"]
    writer(path, bench=bench("/dev/ttyUSB0", "192.168.7.20")).close()
    assert kinds(path)[-1] == "resume"


def test_a_warmer_camera_is_still_the_same_camera(path: Path) -> None:
    whole_session(path)
    warmer = {**DEVICES, "camera": {**DEVICES["camera"], "DeviceTemperature": 41.0}}
    writer(path, devices=warmer).close()
    assert kinds(path)[-1] == "resume"


@pytest.mark.parametrize("is_empty", [True, False])
def test_captures_without_a_journal_are_not_taken_again(path: Path, is_empty: bool) -> None:
    whole_session(path)
    (path / HEAD_NAME).unlink()
    (path / "journal.jsonl").unlink()
    if is_empty:
        (path / "journal.jsonl").touch()
    with pytest.raises(SessionError) as refused:
        writer(path)
    assert refused.value.path == path / "journal.jsonl"
    repair_session(path)
    with writer(path) as session:
        assert session.pending_entries() == ()


def test_a_second_process_is_refused(path: Path) -> None:
    with writer(path), pytest.raises(SessionError) as refused:
        writer(path)
    assert refused.value.fault == "in use"


def test_a_full_disk_is_refused_before_the_start(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with writer(path) as session:
        monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=70 * 2**20))
        session.require_space(5 * 2**20)
        with pytest.raises(SessionError) as refused:
            session.require_space(7 * 2**20)
        assert refused.value.fault == "unwritable"


@pytest.mark.parametrize("failing_write", [0, 1])
def test_a_disk_that_fills_up_in_mid_capture_leaves_a_session_that_resumes(
    path: Path, monkeypatch: pytest.MonkeyPatch, failing_write: int
) -> None:
    frames = (np.full((4, 6), 7, np.uint16),)
    opened: list[Path] = []
    open_ = Path.open

    def full(self: Path, *args: object, **kwargs: object) -> object:
        if self.suffix == ".part":
            opened.append(self)
            if len(opened) == failing_write + 1:
                raise OSError(errno.ENOSPC, "No space left on device")
        return open_(self, *args, **kwargs)  # type: ignore[call-overload]

    with writer(path) as session:
        first = add(session, session.entries[0])
        with monkeypatch.context() as patch:
            patch.setattr(Path, "open", full)
            with pytest.raises(SessionError) as refused:
                add(session, session.entries[1], raw_frames=frames)
            assert refused.value.fault == "unwritable"
    assert Session(path).records == (first,)
    with writer(path, prefix="later") as session:
        assert session.pending_entries()[0].index == 1
        add(session, session.entries[1], raw_frames=frames)
    assert verify(path).is_ok
    assert not list(path.rglob("*.part"))


@pytest.mark.slow
@pytest.mark.parametrize("is_torn", [False, True])
def test_whichever_call_the_full_disk_refuses_a_session_error_says_so_and_the_session_resumes(
    path: Path, monkeypatch: pytest.MonkeyPatch, is_torn: bool
) -> None:
    fsync = os.fsync
    calls: list[int] = []
    for allowed in count():
        calls.clear()

        def full(descriptor: int, allowed: int = allowed) -> None:
            calls.append(descriptor)
            if len(calls) > allowed:
                raise OSError(errno.ENOSPC, "No space left on device")
            fsync(descriptor)

        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", full)
            try:
                with writer(path, prefix=f"full{allowed}") as session:
                    add(session, session.pending_entries()[0], 1000.0)
            except SessionError as error:
                refused = error
        with writer(path, prefix=f"then{allowed}") as session:
            if session.pending_entries():
                add(session, session.pending_entries()[0], 1000.0)
            session.retake(0, "again", "Ada")
        assert verify(path).is_ok
        if len(calls) <= allowed:
            break
        assert refused.fault == "unwritable"
        assert "No space left on device" in str(refused)
        if is_torn:
            with (path / "journal.jsonl").open("ab") as file:
                file.write(b'{"seq": ')
    assert allowed > 5


def test_a_disk_that_fills_up_at_the_journal_line_leaves_a_session_that_resumes(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int, data: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    with writer(path) as session:
        with monkeypatch.context() as patch:
            patch.setattr(os, "write", full)
            with pytest.raises(SessionError) as refused:
                add(session, session.entries[0])
            assert refused.value.fault == "unwritable"
        assert session.captures == ()
    with writer(path, prefix="later") as session:
        assert [one.record.index for one in session.captures] == [0]
    report = verify(path)
    assert {check.state for check in report.files} == {"ok"}


def test_a_part_left_by_a_kill_is_written_over(path: Path) -> None:
    with writer(path) as session:
        part = path / "captures" / f"{session.entries[0].stem}.tif.part"
        part.write_bytes(b"half")
        add(session, session.entries[0])
    assert not part.exists()


def test_a_foreign_photograph_is_a_capture_of_one_frame(path: Path) -> None:
    image = np.array([[0.5, 255.0], [7.0, 255.0]], np.float32)
    with writer(path, devices={}) as session:
        record = session.add_photograph(
            session.entries[0],
            Photograph(image_dn=image, pixel_format="Mono8", max_level_dn=255, scale_px_per_mm=9.5),
        )
    session_read = Session(path)
    assert session_read.records == (record,)
    assert (record.frames_used, record.saturated_pixels, record.min_dn) == (1, 2, 0.5)
    loaded = session_read.load(record)
    assert loaded.variance_dn2 is None
    np.testing.assert_array_equal(loaded.mean_dn, image)


def test_a_session_is_plain_json_that_people_can_read(path: Path) -> None:
    whole_session(path)
    document = json.loads((path / "session.json").read_text(encoding="utf-8"))
    assert document["schema"] == "standoff.session/1"
    assert document["plan"]["targets"][0]["target"] == "Kante"
    assert document["devices"]["camera"]["ExposureTime"] == 2000.0
    assert "Zoë" in (path / "session.json").read_text(encoding="utf-8")


def test_a_path_that_is_a_file_is_refused(path: Path) -> None:
    path.parent.mkdir(parents=True)
    path.touch()
    with pytest.raises(SessionError) as refused:
        writer(path)
    assert refused.value.fault == "unwritable"


def test_closing_twice_is_harmless(path: Path) -> None:
    session: SessionWriter = writer(path)
    session.close()
    session.close()


def test_a_session_from_before_a_bench_key_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with writer(path):
        pass
    manifest = path / "session.json"
    document = json.loads(manifest.read_text())
    del document["bench"]["capture"]["mains_hz"]
    for key in ("order", "settle_s", "auto_exposure", "drift_check"):
        del document["plan"][key]
    manifest.write_text(json.dumps(document))
    with writer(path) as session:
        assert len(session.pending_entries()) == 6
    other = bench_of()
    changed = {"capture": other.capture.model_copy(update={"mains_hz": 60})}
    with pytest.raises(SessionError) as refused:
        writer(path, bench=other.model_copy(update=changed))
    assert refused.value.keys == ("bench.capture.mains_hz",)
