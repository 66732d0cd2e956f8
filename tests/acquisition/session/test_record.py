import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone

import pytest

from acquisition.errors import SessionError
from acquisition.session.record import CaptureRecord, utc_text
from tests.acquisition.records import PHOTOGRAPH, RECORD


@pytest.mark.parametrize("record", [RECORD, PHOTOGRAPH])
def test_a_record_survives_json_text_and_back_exactly(record: CaptureRecord) -> None:
    assert CaptureRecord.from_json(json.loads(json.dumps(record.to_json()))) == record


@pytest.mark.parametrize(
    ("changed", "key"),
    [
        ({"index": "7"}, "index"),
        ({"index": True}, "index"),
        ({"index": -1}, "index"),
        ({"frames_used": 0}, "frames_used"),
        ({"height_mm": None}, "height_mm"),
        ({"height_mm": float("nan")}, "height_mm"),
        ({"kind": "edges"}, "kind"),
        ({"started_utc": "yesterday"}, "started_utc"),
        ({"started_utc": "2025-03-04T05:06:07"}, "started_utc"),
        ({"started_utc": "2025-03-04T05:06:07+01:00"}, "started_utc"),
        ({"file": "/etc/passwd"}, "file"),
        ({"frames_file": "frames/../../x.tif"}, "frames_file"),
        ({"file": "x" * 100_000}, "file"),
        ({"file": "é" * 200}, "file"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_a_record_that_is_not_one_names_the_key(changed: dict[str, object], key: str) -> None:
    with pytest.raises(SessionError) as refused:
        CaptureRecord.from_json({**RECORD.to_json(), **changed}, source="line 3")
    assert refused.value.fault == "damaged"
    # A key that pydantic cannot check alone is named in the text only.
    assert refused.value.keys in ((key,), ("",))
    assert key in str(refused.value)
    assert str(refused.value).startswith("line 3: ")
    assert len(str(refused.value)) < 400


STATED_SINCE = ("gain", "gain_unit", "black_level", "black_level_unit")
"""Keys that the records of earlier versions lack."""


def test_a_record_of_before_the_units_were_recorded_is_read() -> None:
    document = RECORD.to_json()
    for key in STATED_SINCE:
        del document[key]
    assert CaptureRecord.from_json(document) == replace(
        RECORD, gain=None, gain_unit=None, black_level=None, black_level_unit=None
    )


@pytest.mark.parametrize("key", [key for key in RECORD.to_json() if key not in STATED_SINCE])
def test_no_key_may_be_missing(key: str) -> None:
    document = RECORD.to_json()
    del document[key]
    with pytest.raises(SessionError) as refused:
        CaptureRecord.from_json(document)
    assert refused.value.keys == (key,)


def test_a_height_that_is_not_a_number_cannot_be_recorded() -> None:
    with pytest.raises(ValueError):
        replace(RECORD, height_mm=float("inf"))


def test_a_moment_is_written_in_utc_to_the_microsecond() -> None:
    assert utc_text(datetime(2025, 3, 4, 5, 6, 7, 8, tzinfo=UTC)) == "2025-03-04T05:06:07.000008Z"
    east = timezone(timedelta(hours=2))
    assert utc_text(datetime(2025, 3, 4, 7, 6, 7, tzinfo=east)) == "2025-03-04T05:06:07.000000Z"
