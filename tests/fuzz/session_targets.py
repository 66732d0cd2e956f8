"""Files of the bench and of a capture session: TOML, JSON, journal and capture TIFF."""

from functools import partial
from pathlib import Path

from acquisition.bench import load_bench, parse_overrides
from acquisition.errors import BenchConfigError, PlanError, SessionError
from acquisition.plan import load_plan, plan_entries
from acquisition.session._capture_files import parse_capture, read_capture
from acquisition.session._journal import (
    JournalEvent,
    JournalWriter,
    _read_journal,
    read_journal_file,
)
from acquisition.session._reader import captures_of
from acquisition.session._record import CaptureRecord, Manifest
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


def compare_session(data: bytes) -> object:
    manifest = Manifest.from_bytes(data, source="session.json")
    return manifest.differences(MANIFEST.plan, MANIFEST.bench, MANIFEST.devices)


def parse_settings(data: bytes) -> object:
    return parse_overrides([data.decode("utf-8", "replace")])


BENCH = damaged_toml((CONFIGS / "simulated.toml").read_bytes())
STAGE = damaged_toml((CONFIGS / "zaber_stage.toml").read_bytes())
SETTINGS = damaged_toml(b"camera.exposure_us=2000\nstage.limits_mm=[1, 2]")
PLAN = damaged_toml((CONFIGS / "noise_plan.toml").read_bytes())
SESSION = damaged_json(
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
)
JOURNAL = damaged_bytes((chained_journal(EVENTS), unchained_journal(EVENTS)))
EVENT = damaged_json({"event": "capture", "utc": "t", "uid": "u", "record": RECORD.to_json()})
TIFF = damaged_bytes((capture_bytes(images(RECORD)),))

read_bench = from_file(load_bench, "bench.toml")
read_bench_set = from_file(lambda path: load_bench(path, {"camera.gain_db": 1.0}), "bench.toml")

SESSION_TARGETS = (
    FuzzTarget("bench TOML", BENCH, read_bench, (BenchConfigError,)),
    FuzzTarget("bench TOML with --set", BENCH, read_bench_set, (BenchConfigError,)),
    FuzzTarget("stage TOML", STAGE, read_bench, (BenchConfigError,)),
    FuzzTarget("--set key=value", SETTINGS, parse_settings, (BenchConfigError,)),
    FuzzTarget("plan TOML", PLAN, from_file(read_plan, "plan.toml"), (PlanError,)),
    FuzzTarget("session.json", SESSION, compare_session, (SessionError,)),
    FuzzTarget("journal", JOURNAL, replay, (SessionError,)),
    FuzzTarget(
        "journal opened for writing", JOURNAL, from_file(mend, "journal.jsonl"), (SessionError,)
    ),
    FuzzTarget("capture record", EVENT, parse_record, (SessionError, ValueError)),
    FuzzTarget(
        "capture TIFF", TIFF, partial(parse_capture, source="capture"), (SessionError,), 150
    ),
    FuzzTarget(
        "capture TIFF by its path", TIFF, from_file(read_capture, "capture.tif"), (SessionError,)
    ),
)
