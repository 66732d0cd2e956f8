"""The dialogue with a Zaber axis on a line whose every answer is planned."""

import re
from collections.abc import Callable
from typing import cast

import pytest

from acquisition.errors import (
    DeviceProtocolError,
    DeviceRefusalError,
    DeviceSettingsError,
    DeviceTimeoutError,
)
from acquisition.stages.serial_link import SerialLink
from acquisition.stages.zaber import READ_TRIES, ZaberDevice, checksum

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


def device_on(link: PlannedLink) -> ZaberDevice:
    return ZaberDevice(cast("SerialLink", link), device=1, axis=1, clock=lambda: 0.0)


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
