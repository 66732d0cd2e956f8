"""What the answer to ``$I`` says, and what is said of a controller that gives none."""

import pytest
from hypothesis import given, strategies as st

from acquisition.errors import (
    DeviceError,
    DeviceProtocolError,
    DeviceTimeoutError,
    StageAlarmError,
)
from acquisition.stages.grbl_controller import (
    Heard,
    no_version_error,
    read_firmware,
    too_old_error,
    waiting_error,
)
from acquisition.stages.grbl_wire import Alarm, ErrorReply, Feedback, parse_line

# The answer of grblHAL 1.1f.20260817 in its own simulator, with the lines that a board adds.
GRBLHAL = (
    b"[VER:1.1f.20260817:stand 7]",
    b"[OPT:VNMZHL+,100,1024,3,0]",
    b"[AXS:3:XYZ]",
    b"[NEWOPT:ENUMS,RT+,HOME,TC,SED]",
    b"[FIRMWARE:grblHAL]",
    b"[SIGNALS:D]",
    b"[NVS STORAGE:*EEPROM]",
    b"[FREE MEMORY:131K]",
    b"[DRIVER:RP2350@150MHz]",
    b"[DRIVER VERSION:260324]",
    b"[BOARD:PicoCNC]",
    b"[AUX IO:2,3,0,0]",
    b"[WIFI MAC:02:00:00:00:00:01]",
    b"[PLUGIN:Networking v0.2]",
    b"[PLUGIN:FS stream v0.9]",
)


def feedback(*lines: bytes) -> tuple[Feedback, ...]:
    parsed = [parse_line(line) for line in lines]
    return tuple(message for message in parsed if isinstance(message, Feedback))


def test_the_answer_of_grblhal_is_read() -> None:
    firmware = read_firmware(feedback(*GRBLHAL))
    assert (firmware.family, firmware.version) == ("grblHAL", "1.1f.20260817")
    assert (firmware.user_text, firmware.board) == ("stand 7", "PicoCNC")
    assert firmware.sets_origin


def test_the_answer_of_grbl_is_read() -> None:
    firmware = read_firmware(feedback(b"[VER:1.1h.20190830:]", b"[OPT:V,15,128]"))
    assert (firmware.family, firmware.version, firmware.board) == ("Grbl", "1.1h.20190830", "")
    assert not firmware.sets_origin


@given(
    st.lists(
        st.tuples(st.from_regex(r"[A-Z]{3}[A-Z ]{3,9}X", fullmatch=True), st.text(max_size=20))
    )
)
def test_lines_that_newer_firmware_adds_change_nothing(added: list[tuple[str, str]]) -> None:
    extra = tuple(Feedback(kind, text) for kind, text in added)
    assert read_firmware((*feedback(*GRBLHAL), *extra)) == read_firmware(feedback(*GRBLHAL))


def test_an_old_grbl_is_told_with_its_version_the_one_that_is_needed_and_the_remedy() -> None:
    text = str(too_old_error("the Grbl stage on /dev/ttyUSB0", "0.9j"))
    assert "Grbl 0.9j; Grbl 1.1 is needed" in text
    assert "flash Grbl 1.1 or grblHAL" in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("refusal", "heard", "alarm", "kind"),
    [
        (ErrorReply(8), Heard(garbage=b"x"), Alarm(1), DeviceTimeoutError),
        (ErrorReply(3), Heard(), None, DeviceProtocolError),
        (None, Heard(garbage=b"$GPGGA"), Alarm(1), DeviceProtocolError),
        (None, Heard(), Alarm(1), StageAlarmError),
        (None, Heard(), None, DeviceTimeoutError),
    ],
)
def test_a_controller_without_a_version_is_told_by_what_it_said_instead(
    refusal: ErrorReply | None, heard: Heard, alarm: Alarm | None, kind: type[DeviceError]
) -> None:
    assert type(no_version_error("it", refusal, heard, alarm)) is kind


@pytest.mark.parametrize("state", ["Hold", "Door", "Tool", "Check", "Sleep", "Cooling"])
def test_a_state_that_waits_is_the_code_of_its_error(state: str) -> None:
    error = waiting_error("it", state)
    assert error.code == state
    assert f"state {state}" in str(error)
