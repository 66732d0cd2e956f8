import string
from math import inf, nan

import pytest
from hypothesis import given, strategies as st

from acquisition.errors import DeviceProtocolError
from acquisition.stages.grbl.wire import (
    Alarm,
    Banner,
    ErrorReply,
    Feedback,
    GrblMessage,
    Ok,
    Setting,
    StartupLine,
    StatusReport,
    encode_line,
    jog_command,
    parse_line,
)

POSITIONS = st.lists(
    st.integers(-999_999, 999_999).map(lambda um: um / 1000), min_size=3, max_size=6
)


# Lines of the Grbl 1.1 documentation and of grblHAL.
@pytest.mark.parametrize(
    ("line", "message"),
    [
        (b"ok", Ok()),
        (b"ok\r", Ok()),
        (b"error:15", ErrorReply(15)),
        (b"ALARM:1", Alarm(1)),
        (b"okALARM:3", Alarm(3)),
        (b"Grbl 1.1h ['$' for help]", Banner("Grbl 1.1h ['$' for help]")),
        (b"\xff\x00Grbl 1.1f ['$' for help]", Banner("Grbl 1.1f ['$' for help]")),
        (
            b"GrblHAL 1.1f ['$' or '$HELP' for help]",
            Banner("GrblHAL 1.1f ['$' or '$HELP' for help]"),
        ),
        (b"$13=0", Setting(13, "0")),
        (b"$110=500.000", Setting(110, "500.000")),
        (b"$341=", Setting(341, "")),
        (b"[VER:1.1f.20170801:a name]", Feedback("VER", "1.1f.20170801:a name")),
        (b"[FIRMWARE:grblHAL]", Feedback("FIRMWARE", "grblHAL")),
        (b"[DRIVER VERSION:Grbl 8]", Feedback("DRIVER VERSION", "Grbl 8")),
        (b"[MSG:'$H'|'$X' to unlock]", Feedback("MSG", "'$H'|'$X' to unlock")),
        (b">G54G20:ok", StartupLine("G54G20:ok")),
        (
            b"<Idle|MPos:0.000,-10.000,5.000|FS:0,0>",
            StatusReport(state="Idle", machine=(0.0, -10.0, 5.0)),
        ),
        (
            b"<Hold:0|WPos:1.000,2.000,3.000,4.000|Bf:15,128|F:0|Pn:XZ|WCO:0.5,0.0,-1.0,0.0>",
            StatusReport(
                state="Hold",
                substate=0,
                work=(1.0, 2.0, 3.0, 4.0),
                offset=(0.5, 0.0, -1.0, 0.0),
                pins="XZ",
            ),
        ),
        (
            b"<Alarm:11|MPos:0.000,0.000,-1.000|Bf:35,1023|FS:0,0|Ov:100,100,100|H:0,3|FW:grblHAL>",
            StatusReport(state="Alarm", substate=11, machine=(0.0, 0.0, -1.0), homed=(0, 3)),
        ),
    ],
)
def test_the_published_lines_are_understood(line: bytes, message: GrblMessage) -> None:
    assert parse_line(line) == message


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"okok",
        b"oj",
        b"ok ok",
        b"error:",
        b"error:1x",
        b"<Idle|MPos:0.000,0.0O0,0.000>",
        b"<Idle|MPos:0.000,nan,0.000>",
        b"<Idle|FS:0,0>",
        b"<Idle|MPos:0.000,0.000,0.000",
        b"Idle|MPos:0.000,0.000,0.000>",
        b"<Idle|MPos:0.000,0.000,0.000><Idle|MPos:0.000,0.000,0.000>",
        b"<|MPos:0.000,0.000,0.000>",
        b"<Idle|MPos:0.0,0.0,0.0|MPos:1.0,1.0,1.0>",
        b"<Idle|MPos:0.0,0.0,0.0|H:x>",
        b"$J=G90",
        b"$I",
        b"?",
        b"@01 1 07 OK IDLE -- 0:XX",
        b"\x80\x81",
    ],
)
def test_anything_else_is_a_protocol_error(line: bytes) -> None:
    with pytest.raises(DeviceProtocolError):
        parse_line(line)


@given(st.binary(max_size=200))
def test_arbitrary_bytes_never_crash_the_parser(line: bytes) -> None:
    try:
        parse_line(line)
    except DeviceProtocolError:
        return


NEAR = st.text(alphabet="<>|:,.-$[]=okerrALARM:GblIdeMPos0123456789\x00é", max_size=60)


@given(NEAR)
def test_text_that_looks_like_grbl_never_crashes_the_parser(text: str) -> None:
    try:
        parse_line(text.encode("utf-8"))
    except DeviceProtocolError:
        return


@given(POSITIONS, st.sampled_from(["Idle", "Run", "Jog", "Home", "Door", "Sleep"]), st.booleans())
def test_a_report_is_read_as_it_was_written(
    positions: list[float], state: str, is_machine: bool
) -> None:
    numbers = ",".join(f"{value:.3f}" for value in positions)
    kind = "MPos" if is_machine else "WPos"
    report = parse_line(f"<{state}|{kind}:{numbers}|FS:0,0|WCO:{numbers}>".encode())
    assert isinstance(report, StatusReport)
    assert (report.machine if is_machine else report.work) == tuple(positions)
    assert report.offset == tuple(positions)
    assert report.state == state


@given(st.integers(0, 999))
def test_codes_are_read_as_they_were_written(code: int) -> None:
    assert parse_line(b"error:%d" % code) == ErrorReply(code)
    assert parse_line(b"ALARM:%d" % code) == Alarm(code)


@given(st.integers(0, 9999), st.text(alphabet=string.digits + ".", max_size=10))
def test_settings_are_read_as_they_were_written(number: int, value: str) -> None:
    assert parse_line(f"${number}={value}".encode()) == Setting(number, value)


def test_the_homed_field_of_grblhal_is_read_for_the_axis() -> None:
    def is_homed(field: str, axis: str) -> bool:
        report = parse_line(f"<Idle|MPos:0.0,0.0,0.0{field}>".encode())
        assert isinstance(report, StatusReport)
        return report.is_homed(axis)

    assert not is_homed("", "Z")
    assert is_homed("|H:1", "Z")
    assert not is_homed("|H:0", "Z")
    # With a mask the axis counts: bit 2 is Z.
    assert is_homed("|H:0,4", "Z")
    assert not is_homed("|H:1,3", "Z")


def test_a_jog_is_absolute_in_mm_and_machine_coordinates() -> None:
    assert jog_command("Z", -98.0, 300.0) == "$J=G90G21G53Z-98.000F300.0"
    assert encode_line("$H") == b"$H\n"


@given(st.floats(-1e4, 1e4), st.floats(0.1, 1e5))
def test_every_jog_fits_in_a_line_of_grbl(position_mm: float, feed: float) -> None:
    line = encode_line(jog_command("Z", position_mm, feed))
    assert len(line) < 80
    assert float(line[13:].partition(b"F")[0]) == pytest.approx(position_mm, abs=0.0005)


@pytest.mark.parametrize(
    ("position_mm", "feed"), [(nan, 1.0), (inf, 1.0), (1.0, nan), (1.0, 0.0), (1.0, -5.0)]
)
def test_a_jog_to_nowhere_is_refused(position_mm: float, feed: float) -> None:
    with pytest.raises(ValueError):
        jog_command("Z", position_mm, feed)


@pytest.mark.parametrize("text", ["x" * 80, "$H\n$H", "ü", "\x18"])
def test_what_is_not_one_line_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        encode_line(text)
