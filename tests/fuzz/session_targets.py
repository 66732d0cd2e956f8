"""Files of the bench and of a capture session: TOML, JSON, journal and capture TIFF."""

from pathlib import Path

from acquisition.bench import load_bench, parse_overrides
from acquisition.errors import BenchConfigError, PlanError, SessionError
from acquisition.plan import load_plan, plan_entries
from acquisition.session.capture_files import parse_capture, read_capture
from acquisition.session.journal import (
    JournalEvent,
    JournalWriter,
    _read_journal,
    read_journal_file,
)
from acquisition.session.reader import captures_of
from acquisition.session.record import CaptureRecord, Manifest
from tests.acquisition.journals import chained_journal, unchained_journal
from tests.acquisition.records import RECORD, capture_bytes, images
from tests.acquisition.session_fixtures import DEVICES, bench_of, plan_of
from tests.fuzz.damage import damaged_bytes, damaged_json, damaged_toml
from tests.fuzz.target import FuzzTarget, from_file

CONFIGS = Path(__file__).parents[2] / "configs"
UTC_TEXT = "2025-03-04T05:06:07.000000Z"

MANIFEST = Manifest(
    uid="m",
    created_utc=UTC_TEXT,
    operator="o",
    plan=plan_of(),
    bench=bench_of().model_dump(mode="json"),
    devices=DEVICES,
    software={"python": "3.11"},
)
EVENTS = (
    JournalEvent(kind="start", utc=UTC_TEXT, uid="s", facts={"session_sha256": "ab"}),
    JournalEvent(kind="capture", utc=UTC_TEXT, uid="u7", facts={"record": RECORD.to_json()}),
    JournalEvent(kind="exclude", utc=UTC_TEXT, uid="x", facts={"capture": "u7", "reason": "r"}),
    JournalEvent(kind="retake", utc=UTC_TEXT, uid="t", facts={"supersedes": "u7"}),
)
JOURNALS = chained_journal(EVENTS), unchained_journal(EVENTS)


def read_plan(path: Path) -> object:
    return plan_entries(load_plan(path))


def replay(data: bytes) -> object:
    return captures_of(_read_journal(data).events, source="journal")


def mend(path: Path) -> None:
    """Open for writing, which cuts a torn tail off; then all of it is sound."""
    with JournalWriter(path):
        pass
    assert not read_journal_file(path).torn_tail


def parse_record(data: bytes) -> object:
    event = JournalEvent.from_line(data)
    return CaptureRecord.from_json(event.facts.get("record", event.facts), source="record")


def parse_settings(data: bytes) -> object:
    return parse_overrides([data.decode("utf-8", "replace")])


SESSION_TARGETS = (
    FuzzTarget(
        name="bench TOML",
        data=damaged_toml((CONFIGS / "simulated.toml").read_bytes()),
        read=from_file(load_bench, "bench.toml"),
        documented=(BenchConfigError,),
    ),
    FuzzTarget(
        name="bench TOML with --set",
        data=damaged_toml((CONFIGS / "simulated.toml").read_bytes()),
        read=from_file(lambda path: load_bench(path, {"camera.gain_db": 1.0}), "bench.toml"),
        documented=(BenchConfigError,),
    ),
    FuzzTarget(
        name="stage TOML",
        data=damaged_toml((CONFIGS / "zaber_stage.toml").read_bytes()),
        read=from_file(load_bench, "bench.toml"),
        documented=(BenchConfigError,),
    ),
    FuzzTarget(
        name="--set key=value",
        data=damaged_toml(b"camera.exposure_us=2000\nstage.limits_mm=[1, 2]"),
        read=parse_settings,
        documented=(BenchConfigError,),
    ),
    FuzzTarget(
        name="plan TOML",
        data=damaged_toml((CONFIGS / "noise_plan.toml").read_bytes()),
        read=from_file(read_plan, "plan.toml"),
        documented=(PlanError,),
    ),
    FuzzTarget(
        name="session.json",
        data=damaged_json(
            {
                "schema": "standoff.session/1",
                "uid": "m",
                "created_utc": UTC_TEXT,
                "operator": "o",
                "plan": MANIFEST.plan.to_json(),
                "bench": dict(MANIFEST.bench),
                "devices": DEVICES,
                "software": dict(MANIFEST.software),
            }
        ),
        read=lambda data: Manifest.from_bytes(data, source="session.json").differences(
            MANIFEST.plan, MANIFEST.bench, MANIFEST.devices
        ),
        documented=(SessionError,),
    ),
    FuzzTarget(
        name="journal",
        data=damaged_bytes(JOURNALS),
        read=replay,
        documented=(SessionError,),
    ),
    FuzzTarget(
        name="journal opened for writing",
        data=damaged_bytes(JOURNALS),
        read=from_file(mend, "journal.jsonl"),
        documented=(SessionError,),
    ),
    FuzzTarget(
        name="capture record",
        data=damaged_json({"event": "capture", "utc": "t", "uid": "u", "record": RECORD.to_json()}),
        read=parse_record,
        documented=(SessionError, ValueError),
    ),
    FuzzTarget(
        name="capture TIFF",
        data=damaged_bytes((capture_bytes(images(RECORD)),)),
        read=lambda data: parse_capture(data, source="capture"),
        documented=(SessionError,),
        examples=150,
    ),
    FuzzTarget(
        name="capture TIFF by its path",
        data=damaged_bytes((capture_bytes(images(RECORD)),)),
        read=from_file(read_capture, "capture.tif"),
        documented=(SessionError,),
    ),
)
