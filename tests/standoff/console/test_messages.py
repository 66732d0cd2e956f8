"""What a page may send: anything at all, and the console goes on."""

import copy
import json
import math
import re
from pathlib import Path
from typing import Any, get_args

import pytest
from hypothesis import given, settings, strategies as st
from pydantic import BaseModel

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("httpx2", reason="starlette's test client needs httpx2")


from starlette.testclient import WebSocketTestSession

from standoff.console.plans import PlanDraft, TargetDraft
from standoff.console.web._command_handler import MESSAGES, CommandHandler, parse_message
from standoff.console.web._messages import MessageError
from standoff.errors import REPORTED_ERRORS
from tests.standoff.console.hub_fixtures import idle_hub
from tests.standoff.console.served import page_client


def command_of(kind: type[BaseModel]) -> str:
    """What the messages of a kind say they do."""
    return str(get_args(kind.model_fields["do"].annotation)[0])


COMMANDS = sorted(map(command_of, MESSAGES))
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=8,
)
FIELDS = sorted({name for kind in MESSAGES for name in kind.model_fields})
NEARLY = st.builds(
    lambda what, fields: {"do": what, **fields},
    st.sampled_from(COMMANDS),
    st.dictionaries(st.sampled_from(FIELDS), JSON | st.floats(0, 500) | st.just("two"), max_size=4),
)


@given(text=st.text() | JSON.map(json.dumps) | NEARLY.map(json.dumps))
def test_a_text_is_a_message_or_refused_in_one_line(text: str) -> None:
    try:
        message = parse_message(text)
    except MessageError as error:
        if len(str(error).splitlines()) != 1:
            pytest.fail(f"not one line: {error!r}")
        return
    assert message.do in COMMANDS


@pytest.mark.parametrize(
    "text",
    [
        '{"do": "move", "height_mm": NaN}',
        '{"do": "move", "height_mm": Infinity}',
        '{"do": "move", "height_mm": "3"}',
        '{"do": "move", "height_mm": 3, "quickly": true}',
        '{"do": "exposure", "exposure_us": 0}',
        '{"do": "exposure", "exposure_us": -1}',
        '{"do": "region", "region": [1, 2, 3]}',
        '{"do": "hello", "viewer": "me"}',
        '{"do": "retake", "session": "s", "index": -1}',
        '{"do": "quit"}',
        "[]",
        "",
        '{"do": "stop", "x": "' + "y" * 5000 + '"}',
        "[" * 3000,
    ],
)
def test_what_is_out_of_range_or_unknown_is_refused(text: str) -> None:
    with pytest.raises(MessageError):
        parse_message(text)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"do": "exposure", "exposure_us": 0}', "The exposure must be more than 0 µs."),
        (
            '{"do": "exposure", "exposure_us": 1e9}',
            "The exposure must be at most 100000000 µs.",
        ),
        ('{"do": "gain", "gain_db": -1.5}', "The gain must be at least 0 dB."),
        ('{"do": "sweep-focus", "steps": 3}', "The number of heights must be at least 7."),
        ('{"do": "sweep-focus", "steps": 7.5}', "The number of heights must be a whole number."),
        (
            '{"do": "run", "plan": "two", "session": ""}',
            "The session's name must not be empty.",
        ),
    ],
)
def test_what_an_operator_typed_is_refused_in_the_words_of_the_page(text: str, words: str) -> None:
    with pytest.raises(MessageError) as refused:
        parse_message(text)
    assert str(refused.value) == words


VALID = {
    "viewer": "0" * 32,
    "exposure_us": 1000.0,
    "frames": 1,
    "start": (0.0, 0.0),
    "end": (1.0, 1.0),
    "region": (0, 0, 20, 20),
    "metric": "tenengrad",
    "is_on": True,
    "result": "noise",
    "sha256": "0" * 64,
    "photographs": ["0" * 64],
    "sessions": ["one", "another"],
    "followups": [0, 1],
    "kind": "edge",
    "file_format": "nexus",
    "draft": {"name": "typed", "targets": [{"kind": "edge", "target": "edge"}]},
}
WRONG: tuple[object, ...] = (
    None,
    True,
    "x",
    "",
    "x" * 2500,
    -1,
    -1e9,
    2.5,
    1e12,
    10**30,
    math.nan,
    math.inf,
    [],
    {},
)
NOT_TYPED = {
    "viewer", "pictures", "sequence", "number", "id", "x", "y", "start", "end", "region", "metric",
    "is_on", "has_field", "ends_at_peak", "is_relative", "is_replacing", "is_long_wanted",
    "choice", "result", "order", "keep_frames", "auto_exposure", "drift_check", "draft",
    "in_hand_ms", "round_trip_ms", "file", "curve", "sha256", "photographs", "file_format",
    "sessions", "followups",
}  # fmt: skip
PROGRAMMERS_WORDS = re.compile(
    r"Input|should|Field|valid|type=|\bstring|\binteger|\bunion|tuple|\b[a-z]+_[a-z]+|[a-z]\.[a-z0-9]"
)


def meant(kind: type[BaseModel]) -> dict[str, Any]:
    """The fields of a message that is understood."""
    fields: dict[str, Any] = {"do": command_of(kind)}
    for name, field in kind.model_fields.items():
        if name != "do" and field.is_required():
            fields[name] = VALID.get(name, "name" if "str" in str(field.annotation) else 1)
    return fields


def places(kind: type[BaseModel]) -> list[tuple[str, ...]]:
    """The paths of all fields of a message, with those of a plan and of its first target."""
    own: list[tuple[str, ...]] = [(name,) for name in kind.model_fields if name != "do"]
    if ("draft",) in own:
        own += [("draft", name) for name in PlanDraft.model_fields]
        own += [("draft", "targets", "0", name) for name in TargetDraft.model_fields]
    return own


def with_value(fields: dict[str, Any], place: tuple[str, ...], value: object) -> str:
    """The message with one value replaced."""
    made = copy.deepcopy(fields)
    inner: Any = made
    for name in place[:-1]:
        inner = inner[int(name) if name.isdecimal() else name]
    inner[place[-1]] = value
    return json.dumps(made)


def refused(text: str) -> MessageError | None:
    try:
        parse_message(text)
    except MessageError as error:
        return error
    return None


@pytest.mark.parametrize("kind", MESSAGES, ids=command_of)
def test_no_field_of_any_message_is_refused_in_words_for_programmers(
    kind: type[BaseModel],
) -> None:
    fields = meant(kind)
    parse_message(json.dumps(fields))
    for place in places(kind):
        errors = [error for value in WRONG if (error := refused(with_value(fields, place, value)))]
        assert len(errors) >= 3, place  # the values are wrong indeed
        for error in errors:
            words = str(error)
            assert not PROGRAMMERS_WORDS.search(words), (place, words)
            if place != ("draft",):  # which lacks what is typed in
                assert words.startswith("The ") == (place[-1] not in NOT_TYPED), (place, words)
            assert error.do == fields["do"]
            assert error.key.split(".")[: len(place)] == list(place)
    for text in (json.dumps(fields | {"quickly": 1}), '{"do": "fly"}', "[]", "{", '"\\ud800"'):
        with pytest.raises(MessageError, match="reload it"):
            parse_message(text)


def test_a_message_is_read_as_it_was_meant() -> None:
    for text, do, arguments in (
        ('{"do": "move", "height_mm": 3}', "move", {"height_mm": 3.0, "is_relative": False}),
        ('{"do": "region", "region": [1, 2, 30, 40]}', "region", {"region": (1, 2, 30, 40)}),
    ):
        message = parse_message(text)
        assert (message.do, message.arguments) == (do, arguments)


@given(sent=NEARLY)
@settings(max_examples=60)
def test_no_message_of_the_holder_raises_anything_unexpected(
    sent: dict[str, object], tmp_path_factory: pytest.TempPathFactory
) -> None:
    hub = idle_hub(tmp_path_factory.mktemp("fuzz"))
    hub.control.join("me", "Ada")
    try:
        message = parse_message(json.dumps(sent))
        CommandHandler(hub).carry_out("me", message)
    except REPORTED_ERRORS:
        return
    finally:
        job = hub.jobs.current
        if job is not None:
            hub.stop()
            assert job.ended.wait(300)


def answer_to(socket: WebSocketTestSession) -> dict[str, object]:
    """The next message that is no state of the bench."""
    while True:
        message = socket.receive_json()
        if message["type"] not in ("state", "plan", "levels"):
            return dict(message)


def test_a_page_that_talks_nonsense_is_told_so_and_stays_connected(tmp_path: Path) -> None:
    hub = idle_hub(tmp_path)
    nonsense = ["", "{", "[1]", '{"do": 3}', '{"do": "fly"}', "\u0000", "9" * 4000, '"\\ud800"']
    with (
        page_client(hub) as client,
        client.websocket_connect(
            "ws://127.0.0.1/live", headers={"origin": "http://127.0.0.1"}
        ) as socket,
    ):
        socket.send_json({"do": "hello", "viewer": "0" * 32})
        for text in nonsense:
            socket.send_text(text)
            assert answer_to(socket)["type"] == "refused"
        socket.send_bytes(b"\x00\xff")
        assert answer_to(socket)["text"] == "a message must be text"
        socket.send_json({"do": "preview", "plan": "two"})
        assert answer_to(socket)["captures"] == 2
