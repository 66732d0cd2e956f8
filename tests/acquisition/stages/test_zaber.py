"""A Zaber axis: its wire, its moves and its scale."""

import re
from collections.abc import Callable
from typing import Any, cast

import pytest
from hypothesis import assume, given, strategies as st

from acquisition.bench import StageConfig
from acquisition.errors import (
    BenchConfigError,
    DeviceProtocolError,
    DeviceRefusalError,
    DeviceSettingsError,
    DeviceTimeoutError,
)
from acquisition.stages._serial_link import SerialLink
from acquisition.stages.zaber import (
    READ_TRIES,
    _ZaberAlert,
    _ZaberDevice,
    _ZaberInfo,
    _ZaberReply,
    _ZaberScale,
    checksum,
    encode_command,
    parse_message,
)

Answer = Callable[[int], list[bytes]]


def sealed(text: str) -> bytes:
    return f"{text}:{checksum(text[1:]):02X}".encode()


def reply(data: str, *, flag: str = "OK", device: int = 1, is_sealed: bool = True) -> Answer:
    """An answer with the id of the command; ``data`` is what follows state and warning."""

    def lines(message_id: int) -> list[bytes]:
        text = f"@{device:02d} 1 {message_id:02d} {flag} IDLE -- {data}".rstrip()
        return [sealed(text) if is_sealed else text.encode()]

    return lines


def silence(_: int) -> list[bytes]:
    return []


class PlannedLink:
    """Answers each command with the next plan, the last one for ever; then it is silent."""

    name = "zaber on virtual"

    def __init__(self, *answers: Answer, noise: tuple[bytes, ...] = ()) -> None:
        self._answers = list(answers)
        self._waiting: list[bytes] = []
        self._noise = list(noise)
        self.written: list[bytes] = []

    def write(self, data: bytes) -> None:
        self.written.append(data)
        found = re.match(rb"/\d+ \d+ (\d+)", data)
        assert found is not None
        answer = self._answers.pop(0) if len(self._answers) > 1 else self._answers[0]
        self._waiting = answer(int(found[1]))

    def read_line(self, timeout_s: float) -> bytes:
        assert timeout_s >= 0
        if not self._waiting:
            raise DeviceTimeoutError(f"{self.name} does not answer")
        return self._waiting.pop(0)

    def drain(self, quiet_s: float, timeout_s: float) -> list[bytes]:
        assert 0 < quiet_s < timeout_s
        return self._noise

    def close(self) -> None:
        self._waiting = []


def device_on(link: PlannedLink) -> _ZaberDevice:
    return _ZaberDevice(cast("SerialLink", link), device=1, axis=1, clock=lambda: 0.0)


def test_replies_of_others_alerts_and_stale_ones_answer_nothing() -> None:
    def lines(message_id: int) -> list[bytes]:
        return [
            sealed("!01 1 IDLE --"),
            *reply("9")(message_id + 1),
            *reply("8", device=2)(message_id),
            *reply("7")(message_id),
        ]

    assert device_on(PlannedLink(lines)).number("pos") == 7.0


def test_a_question_is_asked_again_where_its_answer_was_lost() -> None:
    link = PlannedLink(silence, lambda _: [b"@01 1 0"], reply("1234"))
    assert device_on(link).number("pos") == 1234.0
    assert len(link.written) == READ_TRIES == 3


def test_a_question_that_is_never_answered_is_an_error() -> None:
    link = PlannedLink(silence)
    with pytest.raises(DeviceTimeoutError):
        device_on(link).ask("")
    assert len(link.written) == READ_TRIES


def test_a_rejected_question_says_why() -> None:
    with pytest.raises(DeviceRefusalError) as rejected:
        device_on(PlannedLink(reply("BADDATA", flag="RJ"))).number("pos")
    assert rejected.value.code == "BADDATA"


def test_once_checksums_are_on_a_reply_without_one_is_spoilt() -> None:
    link = PlannedLink(reply("0"), reply("5", is_sealed=False))
    device = device_on(link)
    device.connect()
    with pytest.raises(DeviceProtocolError):
        device.ask("")


def test_firmware_that_has_no_checksums_is_believed_without() -> None:
    link = PlannedLink(reply("BADCOMMAND", flag="RJ", is_sealed=False), reply("5", is_sealed=False))
    device = device_on(link)
    device.connect()
    assert device.number("pos") == 5.0


def test_a_line_where_something_else_talks_is_told_with_what_it_said() -> None:
    link = PlannedLink(silence, noise=(b"Grbl 1.1h ['$' for help]",))
    with pytest.raises(DeviceTimeoutError) as silent:
        device_on(link).connect()
    assert "Grbl 1.1h" in str(silent.value)
    garbled = PlannedLink(lambda _: [b"ok"])
    with pytest.raises(DeviceProtocolError):
        device_on(garbled).connect()


@pytest.mark.parametrize("data", ["fast", "nan", "inf", "1e999"])
def test_a_setting_that_is_no_number_is_named(data: str) -> None:
    with pytest.raises(DeviceProtocolError):
        device_on(PlannedLink(reply(data))).number("pos")


def test_every_setting_that_differs_is_named() -> None:
    device = device_on(PlannedLink(reply("64"), reply("100"), reply("3")))
    with pytest.raises(DeviceSettingsError) as differing:
        device.check_settings({"resolution": 32.0, "accel": 100.0, "maxspeed": 5.0})
    assert differing.value.settings == ("resolution", "maxspeed")


def test_warnings_are_all_of_those_announced() -> None:
    assert device_on(PlannedLink(reply("02 FS WR"))).warnings() == ("FS", "WR")
    assert device_on(PlannedLink(reply("00"))).warnings() == ()


@pytest.mark.parametrize("data", ["02 FS", "00 WR", "FS"])
def test_warnings_that_do_not_add_up_are_a_spoilt_reply(data: str) -> None:
    with pytest.raises(DeviceProtocolError):
        device_on(PlannedLink(reply(data))).warnings()


FLAGS = st.sampled_from([None, "WR", "FS", "NI"])
WORDS = st.text(alphabet="abcdefghijklmnopqrstuvwxyz0123456789 .-", min_size=1, max_size=30).map(
    str.strip
)


def test_a_command_carries_its_id_and_the_checksum_worked_out_by_hand() -> None:
    # The characters between slash and colon sum to 1354 = 5 * 256 + 0x4A, and 0x100 - 0x4A = 0xB6.
    assert encode_command(1, 1, 7, "move abs 40000") == b"/1 1 07 move abs 40000:B6\n"


def test_an_empty_command_asks_for_the_state() -> None:
    assert encode_command(1, 1, 7, "")[:7] == b"/1 1 07"


@pytest.mark.parametrize(
    ("device", "axis", "message_id", "command"),
    [
        (100, 1, 1, "home"),
        (1, 10, 1, "home"),
        (1, 1, 100, "home"),
        (1, 1, 1, "home:00"),
        (1, 1, 1, "home\n/1 home"),
        (1, 1, 1, "x" * 80),
        (1, 1, 1, "hömé"),
    ],
)
def test_what_is_not_one_command_is_refused(
    device: int, axis: int, message_id: int, command: str
) -> None:
    with pytest.raises(ValueError):
        encode_command(device, axis, message_id, command)


def test_a_rejection_keeps_its_reason() -> None:
    reply = parse_message(sealed("@01 1 07 RJ BUSY WR BADDATA"))
    assert reply == _ZaberReply(
        device=1,
        axis=1,
        message_id=7,
        is_ok=False,
        is_busy=True,
        warning="WR",
        data="BADDATA",
        has_checksum=True,
    )


def test_alerts_and_info_are_told_from_replies() -> None:
    alert = parse_message(b"!01 1 IDLE FS")
    assert alert == _ZaberAlert(device=1, axis=1, is_busy=False, warning="FS", data="")
    info = parse_message(sealed("#01 0 09 some text"))
    assert info == _ZaberInfo(device=1, axis=0, message_id=9, text="some text")


@given(
    st.integers(0, 99),
    st.integers(0, 9),
    st.integers(0, 99),
    st.booleans(),
    st.booleans(),
    FLAGS,
    WORDS,
)
def test_a_reply_is_read_as_it_was_written(
    device: int,
    axis: int,
    message_id: int,
    is_ok: bool,
    is_busy: bool,
    warning: str | None,
    data: str,
) -> None:
    assume(data)
    result = f"{'OK' if is_ok else 'RJ'} {'BUSY' if is_busy else 'IDLE'} {warning or '--'} {data}"
    reply = parse_message(sealed(f"@{device:02d} {axis} {message_id:02d} {result}"))
    assert reply == _ZaberReply(
        device=device,
        axis=axis,
        message_id=message_id,
        is_ok=is_ok,
        is_busy=is_busy,
        warning=warning,
        data=data,
        has_checksum=True,
    )


@given(st.integers(0, 30), st.integers(1, 255))
def test_one_changed_byte_never_passes_as_the_same_reply(place: int, change: int) -> None:
    line = bytearray(sealed("@01 1 07 OK IDLE -- 40000"))
    assume(place < len(line))
    line[place] ^= change
    try:
        changed = parse_message(bytes(line))
    except DeviceProtocolError:
        return
    # What is left are a kind that is not checked, letters of another case in the checksum,
    # and a colon that is none: then the data has no checksum, which the driver refuses.
    assert (
        not isinstance(changed, _ZaberReply) or not changed.has_checksum or place >= len(line) - 2
    )


@given(st.binary(max_size=120))
def test_arbitrary_bytes_never_crash_the_parser(line: bytes) -> None:
    try:
        parse_message(line)
    except DeviceProtocolError:
        return


@given(st.text(alphabet="@!#/: -0123456789OKRJIDLEBUSYWR\x00é", max_size=50))
def test_text_that_looks_like_zaber_never_crashes_the_parser(text: str) -> None:
    try:
        parse_message(text.encode("utf-8"))
    except DeviceProtocolError:
        return


def scale(**keys: Any) -> _ZaberScale:
    return _ZaberScale.of(
        StageConfig.model_validate(
            {
                "driver": "zaber",
                "port": "virtual",
                "microstep_um": 0.5,
                "limits_mm": [10.0, 100.0],
                **keys,
            }
        )
    )


@pytest.mark.parametrize(("direction", "sign"), [("up", 1), ("down", -1)])
def test_a_height_is_its_microsteps_and_back(direction: str, sign: int) -> None:
    found = scale(direction=direction, home_offset_mm=50.0)
    # By hand: 7 mm are 14 000 half micrometres.
    assert found.steps(57.0) == sign * 14_000
    assert found.height_mm(sign * 14_000) == 57.0


@pytest.mark.parametrize("direction", ["up", "down"])
def test_rounding_never_leaves_the_limits(direction: str) -> None:
    # Microsteps of 0.3 mm from 0: 10 lies between 9.9 and 10.2, 100 between 99.9 and 100.2.
    found = scale(direction=direction, microstep_um=300.0)
    assert found.height_mm(found.steps(10.0)) == pytest.approx(10.2)
    assert found.height_mm(found.steps(100.0)) == pytest.approx(99.9)
    # 10.5 lies amid 10.5 itself; 99.8 nearest to 99.9, which is inside.
    assert found.height_mm(found.steps(99.8)) == pytest.approx(99.9)


def test_a_feed_is_the_protocols_unit_of_speed() -> None:
    # 60 mm/min are 2000 microsteps a second, times 1.6384.
    assert scale().maxspeed(60.0) == round(2000 * 1.6384)


def test_a_stage_without_its_microstep_has_no_scale() -> None:
    manual = StageConfig.model_validate({"driver": "manual", "limits_mm": [10.0, 100.0]})
    with pytest.raises(BenchConfigError) as missing:
        _ZaberScale.of(manual)
    assert missing.value.keys == ("stage.microstep_um",)
