"""The serial protocol of GRBL and its codes."""

import string
from math import inf, nan
from random import Random

import pytest
from hypothesis import given, strategies as st

from acquisition.errors import DeviceProtocolError
from acquisition.stages.grbl_wire import (
    ALARMS,
    BLOCKED_BY_ALARM,
    ERRORS,
    HOMING_REQUIRED,
    KNOWN_FIELDS,
    KNOWN_STATES,
    Alarm,
    Banner,
    ErrorReply,
    Feedback,
    GrblMessage,
    Ok,
    Setting,
    StatusReport,
    _StartupLine,
    _StoredLine,
    encode_line,
    jog_command,
    old_grbl_version,
    parse_line,
    passed_over,
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
        (b">G54G20:ok", _StartupLine("G54G20:ok")),
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
        (b"error:79", ErrorReply(79)),
        (b"ALARM:17", Alarm(17)),
        (b"$N0=G54", _StoredLine(0, "G54")),
        (b"$N1=", _StoredLine(1, "")),
        (b">G54:error:3", _StartupLine("G54:error:3")),
        (b"$70=", Setting(70, "")),
        (b"$302=192.168.5.1", Setting(302, "192.168.5.1")),
        (b"$75=********", Setting(75, "********")),
        ("$74=Werkstatt Süd".encode(), Setting(74, "Werkstatt Süd")),
        (b"$300=Grbl 2", Setting(300, "Grbl 2")),
        (b"$10240=1", Setting(10240, "1")),
        (b"[HLP:$$ $# $G $I $N]", Feedback("HLP", "$$ $# $G $I $N")),
        (b"[MSG:]", Feedback("MSG", "")),
        (b"[MSG:Warning: not ready]", Feedback("MSG", "Warning: not ready")),
        (b"[G59.1:0.000,0.000,0.000]", Feedback("G59.1", "0.000,0.000,0.000")),
        (b"[NVS STORAGE:*FLASH 4K]", Feedback("NVS STORAGE", "*FLASH 4K")),
    ],
)
def test_the_published_lines_are_understood(line: bytes, message: GrblMessage) -> None:
    assert parse_line(line) == message


# As grblHAL 1.1f.20260817 sent them; the first is what it reports after a hard limit.
@pytest.mark.parametrize(
    ("line", "report"),
    [
        (
            b"<Alarm:1|MPos:0.000,0.000,-61.020|FS:0,0|H:1,4|$C:1>",
            StatusReport(state="Alarm", substate=1, machine=(0.0, 0.0, -61.02), homed=(1, 4)),
        ),
        (
            b"<Alarm:1|MPos:0.000,0.000,-399.988|Bf:99,1023|FS:0,0|Pn:Z|WCO:0.000,0.000,0.000|"
            b"WCS:G54|Ov:100,100,100|A:|Sc:|MPG:0|H:1,4|T:0|P:0|TLR:0|FW:grblHAL|$C:1>",
            StatusReport(
                state="Alarm",
                substate=1,
                machine=(0.0, 0.0, -399.988),
                offset=(0.0, 0.0, 0.0),
                pins="Z",
                homed=(1, 4),
            ),
        ),
        (
            b"<Home|MPos:0.000,0.000,0.732|Bf:100,1023|FS:0,0|Ov:100,100,100|A:|TLR:0>",
            StatusReport(state="Home", machine=(0.0, 0.0, 0.732)),
        ),
        (
            b"<Run:1|WPos:0.000000,0.000000,1.250000,0.000000,0.000000,0.000000|AR:200>",
            StatusReport(state="Run", substate=1, work=(0.0, 0.0, 1.25, 0.0, 0.0, 0.0)),
        ),
        (b"<Tool|MPos:0.000,0.000,0.000|T:2>", StatusReport(state="Tool", machine=(0.0,) * 3)),
        (b"<Sleep|MPos:0.000,0.000,0.000>", StatusReport(state="Sleep", machine=(0.0,) * 3)),
        (b"<Check|MPos:0.000,0.000,0.000>", StatusReport(state="Check", machine=(0.0,) * 3)),
        (
            b"<Door:4|MPos:0.000,0.000,0.000>",
            StatusReport(state="Door", substate=4, machine=(0.0,) * 3),
        ),
    ],
)
def test_the_reports_of_grblhal_are_understood(line: bytes, report: StatusReport) -> None:
    assert parse_line(line) == report


def test_only_a_report_of_an_alarm_names_one() -> None:
    def alarm(state: str) -> Alarm | None:
        report = parse_line(f"<{state}|MPos:0.000,0.000,0.000>".encode())
        assert isinstance(report, StatusReport)
        return report.alarm

    assert alarm("Alarm:1") == Alarm(1)
    assert [alarm(state) for state in ("Alarm", "Alarm:0", "Hold:1", "Alarm:x")] == [None] * 4


@pytest.mark.parametrize(
    ("line", "names"),
    [
        (b"<Idle|MPos:0.0,0.0,0.0|$C:1|FW:grblHAL|New:a,b|$C:2>", ("field $C", "field New")),
        (b"<Hold:7|MPos:0.0,0.0,0.0>", ("sub-state Hold:7",)),
        (b"<Alarm:42|MPos:0.0,0.0,0.0>", ("sub-state Alarm:42",)),
        (b"<Cooling|MPos:0.0,0.0,0.0>", ("state Cooling",)),
        (b"<Door:4|MPos:0.0,0.0,0.0|Bf:1,2>", ()),
        (b"[WIFI MAC:02:00:00:00:00:01]", ("line [WIFI MAC:...]",)),
        (b"[VER:2.0.20300101:]", ("version 2.0.20300101:",)),
        (b"[FIRMWARE:another]", ("firmware another",)),
        (b"ALARM:42", ("alarm 42",)),
        (b"[VER:1.1f.20260817:bench]", ()),
        (b"[FIRMWARE:grblHAL]", ()),
        (b"[NEWOPT:ENUMS,RT+,HOME,TC,SED]", ()),
        (b"[AXS:3:XYZ]", ()),
        (b"ok", ()),
    ],
)
def test_what_is_passed_over_has_a_name(line: bytes, names: tuple[str, ...]) -> None:
    assert tuple(dict.fromkeys(passed_over(parse_line(line)))) == names


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
        b"<Idle|MPos:0.000,inf,0.000>",
        b"<Idle|MPos:0.000,,0.000>",
        b"<Idle|MPos:>",
        b"<Idle|MPos>",
        b"<Idle|WPos:1.0,2.0,x>",
        b"<Idle|MPos:0.0,0.0,0.0|WCO:0.0,0.0,nan>",
        b"<Idle|MPos:0.0,0.0,0.0|WPos:-,0.0,0.0>",
        b"<Alarm:1|FS:0,0|H:1,4|$C:1>",
        b"<Idle|MPos:0.0,0.0,0.0||FS:0,0>",
        b"<Idle|MPos:0.0,0.0,0.0|:1>",
        b"<Idle|MPos:0.0,0.0,0.0|FS:0,0<Idle|FS:0,0>",
        b"<Idle|MPos:0.0,0.0,0.0|FS:0,\x000>",
        b"<1|MPos:0.0,0.0,0.0>",
        b"<Idle,MPos:0.000,0.000,0.000,WPos:0.000,0.000,0.000>",
        b"$102=25\xff.000",
        b"$=1",
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


NEAR = st.text(alphabet="<>|:,.-$[]=okerrALARM:GblIdeMPosWCOHPnN \t0123456789\x00é", max_size=60)


@given(NEAR)
def test_text_that_looks_like_grbl_never_crashes_the_parser(text: str) -> None:
    try:
        parse_line(text.encode("utf-8"))
    except DeviceProtocolError:
        return


VALUES = st.text(st.sampled_from(string.printable[:95]).filter(lambda c: c not in "|<>"))
NEW_NAMES = st.from_regex(r"[A-Za-z$%#&@_][A-Za-z0-9$%_.]{0,8}", fullmatch=True).filter(
    lambda name: name not in KNOWN_FIELDS
)
NEW_FIELDS = st.lists(st.tuples(NEW_NAMES, VALUES), max_size=4)
UNUSED_FIELDS = st.lists(
    st.tuples(st.sampled_from(sorted(KNOWN_FIELDS - {"MPos", "WPos", "WCO", "H", "Pn"})), VALUES),
    max_size=4,
    unique_by=lambda pair: pair[0],
)


@pytest.mark.slow
@given(
    st.sampled_from(["Idle", "Jog", "Alarm:1", "Hold:0", "Door:1"]),
    POSITIONS,
    NEW_FIELDS,
    UNUSED_FIELDS,
    st.randoms(use_true_random=False),
)
def test_fields_that_are_not_used_never_change_state_or_position(
    state: str,
    positions: list[float],
    new: list[tuple[str, str]],
    unused: list[tuple[str, str]],
    order: Random,
) -> None:
    numbers = ",".join(f"{value:.3f}" for value in positions)
    own = [f"MPos:{numbers}", f"WCO:{numbers}", "H:1,4", "Pn:Z"]
    plain = parse_line(f"<{'|'.join([state, *own])}>".encode())
    fields = [*own, *(f"{name}:{value}" for name, value in new + unused)]
    order.shuffle(fields)
    report = parse_line(f"<{'|'.join([state, *fields])}>".encode())
    assert isinstance(report, StatusReport)
    assert report == plain
    assert report.machine == tuple(positions)
    assert set(report.passed_over) == {f"field {name}" for name, _ in new}


@pytest.mark.slow
@given(st.sampled_from(sorted(KNOWN_STATES)), VALUES, POSITIONS)
def test_a_sub_state_never_changes_state_or_position(
    state: str, substate: str, positions: list[float]
) -> None:
    numbers = ",".join(f"{value:.3f}" for value in positions)
    report = parse_line(f"<{state}:{substate}|MPos:{numbers}>".encode())
    assert isinstance(report, StatusReport)
    assert (report.state, report.machine) == (state, tuple(positions))


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


@pytest.mark.slow
@given(st.integers(0, 9999), st.text(st.characters(exclude_categories=["C", "Z"]), max_size=30))
def test_settings_may_be_any_text(number: int, value: str) -> None:
    assert parse_line(f"${number}={value}".encode()) == Setting(number, value)


@pytest.mark.parametrize("before", [b"$132=400.000", b"$300=Grbl 2", b"[MSG:Pgm End"])
def test_a_greeting_or_an_alarm_that_follows_a_line_without_its_end_is_heard(before: bytes) -> None:
    assert isinstance(parse_line(before + b"Grbl 1.1h ['$' for help]"), Banner)
    assert parse_line(before + b"ALARM:3") == Alarm(3)


@pytest.mark.parametrize(
    ("line", "version"),
    [
        (b"Grbl 0.9j ['$' for help]", "0.9j"),
        (b"\xff\x00Grbl 0.8c ['$' for help]", "0.8c"),
        (b"Grbl 0.6b", "0.6b"),
        (b"Grbl 0.845 ['$' for help]", "0.845"),
        (b"[0.9j.20160316:]", "0.9j"),
        (b"[0.9j.20160316:my stand]", "0.9j"),
        (b"<Idle,MPos:0.000,0.000,0.000,WPos:0.000,0.000,0.000>", "0.9 or older"),
        (b"error: Expected command letter", "0.9 or older"),
        (b"error: EEPROM read fail. Using defaults", "0.9 or older"),
        (b"ALARM: Hard limit", "0.9 or older"),
        (b"ALARM: Hard/soft limit", "0.9 or older"),
        (b"Grbl 1.1h ['$' for help]", None),
        (b"GrblHAL 1.1f ['$' or '$HELP' for help]", None),
        (b"[VER:1.1f.20170801:]", None),
        (b"<Idle|MPos:0.000,0.000,0.000|FS:0,0>", None),
        (b"error:5", None),
        (b"ALARM:1", None),
        (b"$27=1.000", None),
    ],
)
def test_grbl_before_1_1_is_known_by_its_greeting_version_reports_and_errors(
    line: bytes, version: str | None
) -> None:
    assert old_grbl_version(line) == version


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


OBVIOUS = (3, 6)
"""Somebody reset it: there is nothing to look for."""


def test_every_alarm_of_grbl_and_grblhal_has_a_meaning_of_its_own() -> None:
    # Grbl 1.1 has 1 to 10, grblHAL 1.1f.20260817 has 1 to 22.
    assert sorted(ALARMS) == list(range(1, 23))
    assert len({alarm.meaning for alarm in ALARMS.values()}) == len(ALARMS)


@pytest.mark.parametrize("code", ALARMS)
def test_every_alarm_says_what_to_look_for_and_ends_in_homing(code: int) -> None:
    alarm = Alarm(code)
    assert alarm.text == f"ALARM:{code} ({ALARMS[code].meaning})"
    assert "\n" not in alarm.remedy
    assert ("clear the alarm" in alarm.remedy) == (code != HOMING_REQUIRED)
    assert "home" in alarm.remedy
    assert bool(ALARMS[code].remedy) == (code not in (*OBVIOUS, HOMING_REQUIRED))


@pytest.mark.parametrize("code", [8, 9, 15])
def test_a_home_switch_that_is_not_found_or_released_sends_to_wiring_and_pull_off(
    code: int,
) -> None:
    assert "wiring" in Alarm(code).remedy
    assert "$27" in Alarm(code).remedy


def test_the_pull_off_is_to_be_longer_if_it_did_not_release_and_shorter_if_it_lost_the_switch() -> (
    None
):
    # Grbl 1.1: "Try increasing pull-off setting", and "decreasing pull-off distance".
    assert "longer pull-off" in Alarm(8).remedy
    assert "shorter pull-off" in Alarm(9).remedy


def test_alarm_10_is_an_emergency_stop_or_the_second_switch_of_grbl() -> None:
    assert "emergency stop" in Alarm(10).text
    assert "second home switch" in Alarm(10).text


@pytest.mark.parametrize("code", [0, 23, 42, 255])
def test_a_code_that_is_not_known_keeps_its_number_and_the_way_back(code: int) -> None:
    assert f"ALARM:{code} (see the manual" in Alarm(code).text
    assert Alarm(code).remedy == "clear the alarm, then home"
    if code not in ERRORS:
        assert f"error:{code} (see the manual" in ErrorReply(code).text


def test_errors_of_grblhal_beyond_those_of_grbl_have_a_meaning() -> None:
    for code in (45, 46, 50, 52, BLOCKED_BY_ALARM):
        assert "manual" not in ErrorReply(code).text
