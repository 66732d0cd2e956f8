"""The Grbl driver with grblHAL as it is today, and with Grbl before 1.1."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from acquisition.errors import (
    DeviceProtocolError,
    DeviceTimeoutError,
    StageAlarmError,
    StageLimitError,
    StageNotHomedError,
)
from acquisition.stages._grbl_setup import work_envelope
from acquisition.stages._serial_link import _WireLog
from acquisition.stages.grbl_wire import BEYOND_TRAVEL, jog_command
from hil_mocks.stages._grbl import GrblFirmware
from hil_mocks.stages._grbl_protocol import GrblDialect
from hil_mocks.stages._plant import PlantFaults, StagePlant
from hil_mocks.stages._serial_stage import LineFaults
from tests.hil_mocks.stage_checks import (
    DIALECTS,
    TARGET_MM,
    assert_nothing_moves,
    assert_works_again,
    clear_home_and_work,
)
from tests.hil_mocks.stage_rigs import GrblRig, grbl_rig, homed_grbl

HARD_LIMITS = {21: 1.0, 20: 0.0}
REPORTS_ALARMS = {10: 511.0 + 1024.0}
"""grblHAL's $10 with the alarm in every report; without, only a full report has it."""


@pytest.fixture
def log(tmp_path: Path) -> Iterator[_WireLog]:
    with _WireLog(tmp_path / "stage.log") as opened:
        yield opened


def notes(folder: Path) -> list[str]:
    """Remarks in the wire log, without their times."""
    lines = (folder / "stage.log").read_text("ascii").splitlines()
    return [line.partition(" # ")[2] for line in lines if " # " in line]


def struck(**keys: object) -> GrblRig:
    """A homed stage that ran into its upper switch, which stands where it should not."""
    rig = homed_grbl("grblhal", settings=HARD_LIMITS, **keys)
    rig.plant.high_switch_mm = 100.0
    with pytest.raises(StageAlarmError):
        rig.stage.move_to(TARGET_MM, 120)
    return rig


def answer(firmware: GrblFirmware, sent: bytes, now_s: float = 1.0) -> list[str]:
    firmware.receive(sent)
    firmware.advance(now_s)
    return [line.decode().strip() for line in firmware.take_lines()]


class TestEmulator:
    """Lines of grblHAL 1.1f.20260817 in its own simulator are what the emulator has to send."""

    @pytest.fixture
    def firmware(self) -> GrblFirmware:
        """It was homed with $HZ and ran into its lower switch, with hard limits on."""
        plant = StagePlant(low_switch_mm=119.5, high_switch_mm=519.5, start_mm=125.0)
        firmware = GrblFirmware(plant, dialect="grblhal", settings={22: 3, 20: 0, 21: 1})
        assert answer(firmware, b"$HZ\n", 60.0)[-3:] == ["[MSG:]", ">G54:ok", "ok"]
        struck = answer(firmware, b"$J=G90G21G53Z-410F1200\n", 70.0)
        assert struck == ["ok", "ALARM:1", "[MSG:Reset to continue]"]
        return firmware

    def test_a_full_report_after_a_hard_limit_has_every_field(self, firmware: GrblFirmware) -> None:
        (report,) = answer(firmware, b"\x87")
        height = report.partition("|MPos:0.000,0.000,")[2].partition("|")[0]
        assert float(height) == pytest.approx(-400.0, abs=0.2)
        assert report == (
            f"<Alarm:1|MPos:0.000,0.000,{height}|Bf:100,1023|FS:0,0|Pn:Z|WCO:0.000,0.000,0.000|"
            "WCS:G54|Ov:100,100,100|A:|Sc:|MPG:0|H:1,4|T:0|P:0|TLR:0|FW:grblHAL|$C:1>"
        )

    def test_a_hard_limit_leaves_questions_and_settings_and_nothing_else(
        self, firmware: GrblFirmware
    ) -> None:
        assert answer(firmware, b"$I\n")[0] == "[VER:1.1f.20260817:]"
        assert "$74=Werkstatt Süd" in answer(firmware, b"$$\n")
        assert answer(firmware, b"$N\n") == ["$N0=G54", "$N1=", "ok"]
        assert answer(firmware, b"$132=400\n") == ["ok"]
        for line in (b"$X\n", b"$H\n", b"$HZ\n", b"$J=G90G21G53Z-310F1200\n", b"$C\n"):
            assert answer(firmware, line) == ["error:79"]
        assert answer(firmware, b"G0Z1\n") == ["error:9"]

    def test_a_reset_ends_it_in_the_same_alarm_which_is_then_unlocked(
        self, firmware: GrblFirmware
    ) -> None:
        assert answer(firmware, b"\x18") == [
            "",
            "GrblHAL 1.1f ['$' or '$HELP' for help]",
            "[MSG:'$H'|'$X' to unlock]",
        ]
        (report,) = answer(firmware, b"\x87")
        assert report.startswith("<Alarm:1|")
        assert report.endswith("|H:0,0|T:0|P:0|TLR:0|FW:grblHAL>")
        assert answer(firmware, b"$X\n") == ["[MSG:Caution: Unlocked]", "ok"]

    def test_strict_hard_limits_look_at_the_switches_after_a_start(
        self, firmware: GrblFirmware
    ) -> None:
        assert answer(firmware, b"$21=3\n\x18")[-2:] == ["ALARM:12", "[MSG:Check Limits]"]
        assert answer(firmware, b"$X\n") == ["[MSG:Check Limits]", "error:45"]

    def test_homing_that_is_required_is_an_alarm_at_every_start(self) -> None:
        firmware = GrblFirmware(StagePlant(), dialect="grblhal", settings={22: 5})
        assert answer(firmware, b"\x18")[-2:] == ["ALARM:11", "[MSG:Homing cycle required]"]
        assert answer(firmware, b"$X\n") == ["error:46"]

    def test_a_stage_at_rest_is_still_homed_after_a_reset(self) -> None:
        rig = homed_grbl("grblhal")
        rig.firmware.press_reset()
        assert "|H:1|" in answer(rig.firmware, b"\x87", rig.clock.now_s)[-1]


class TestHardLimit:
    @pytest.mark.parametrize("bits", [{}, REPORTS_ALARMS], ids=["full reports", "all reports"])
    def test_it_is_alarm_1_for_whoever_asks_and_the_way_back_is_unlock_and_home(
        self, bits: dict[int, float]
    ) -> None:
        rig = struck()
        rig.firmware.settings |= bits
        for stage in (rig.stage, rig.reopen()):
            assert stage.state == "alarm"
            assert not stage.is_homed
            assert "ALARM:1 (" in stage.warnings[0]
            for call in (lambda: rig.stage.move_to(TARGET_MM, 120), lambda: rig.stage.home(120)):
                with pytest.raises(StageAlarmError) as alarmed:
                    call()
                assert alarmed.value.code == 1
        assert_nothing_moves(rig, StageAlarmError)
        rig.plant.high_switch_mm = 409.5
        clear_home_and_work(rig)
        assert not any("ALARM" in warning for warning in rig.stage.warnings)

    def test_a_line_that_was_lost_is_made_good_by_the_next_report(self) -> None:
        rig = homed_grbl("grblhal", settings=HARD_LIMITS | REPORTS_ALARMS)
        rig.plant.high_switch_mm = 100.0
        rig.line.faults = LineFaults(only=b"ALARM", lose=True)
        with pytest.raises(StageAlarmError) as alarmed:
            rig.stage.move_to(TARGET_MM, 120)
        assert alarmed.value.code == 1
        assert not rig.stage.is_homed

    def test_a_later_report_with_another_code_counts(self) -> None:
        rig = struck()
        rig.firmware.settings |= REPORTS_ALARMS
        rig.firmware.press_reset()
        rig.reopen()
        rig.line.faults = LineFaults(only=b"ALARM", lose=True)
        rig.firmware.raise_alarm(17)
        with pytest.raises(StageAlarmError) as alarmed:
            rig.stage.move_to(TARGET_MM, 120)
        assert alarmed.value.code == 17

    def test_an_alarm_that_somebody_else_cleared_is_over(self) -> None:
        rig = struck()
        rig.firmware.press_reset()
        rig.firmware.receive(b"$X\n")
        rig.firmware.take_lines()
        assert rig.stage.state == "idle"
        assert not any("ALARM" in warning for warning in rig.stage.warnings)
        assert not rig.reopen().is_homed
        assert_nothing_moves(rig)

    def test_a_grbl_that_answers_nothing_in_it_is_reset_at_opening(self) -> None:
        rig = homed_grbl("grbl", settings=HARD_LIMITS)
        rig.firmware.raise_alarm(1)
        rig.firmware.take_lines()
        with pytest.raises(DeviceTimeoutError):
            rig.reopen()
        rig.reopen(reset=True)
        clear_home_and_work(rig)


class TestStart:
    def test_homing_that_is_required_is_asked_for_and_not_a_failure(self) -> None:
        rig = grbl_rig("grblhal", settings={22: 5} | REPORTS_ALARMS)
        assert rig.stage.state == "alarm"
        assert rig.stage.warnings == ()
        with pytest.raises(StageNotHomedError):
            rig.stage.move_to(TARGET_MM, 120)
        rig.stage.home(120)
        assert_works_again(rig)

    def test_a_switch_that_is_pressed_at_the_start_is_alarm_12_and_homing_the_way_out(self) -> None:
        rig = grbl_rig("grblhal", settings={21: 3}, connect=False)
        rig.plant.place(rig.plant.low_switch_mm)
        rig.axis.connect()
        with pytest.raises(StageAlarmError) as alarmed:
            rig.stage.move_to(TARGET_MM, 120)
        assert alarmed.value.code == 12
        clear_home_and_work(rig)

    def test_homing_has_the_time_that_the_settings_ask_for_from_the_first_time_on(self) -> None:
        # 400 mm and half as much again at 60 mm/min is 600 s, and more for the pull-offs.
        assert grbl_rig(settings={25: 60}).stage.homing_s > 600.0


class TestWhatItSays:
    def test_what_is_not_known_is_noted_once_and_changes_nothing(
        self, log: _WireLog, tmp_path: Path
    ) -> None:
        rig = homed_grbl("grblhal", settings=REPORTS_ALARMS, log=log)
        rig.fail(adds_fields="|$Q:1|New:a,b|SP9:0,,C")
        for height_mm in (TARGET_MM, 60.0):
            assert rig.stage.move_to(height_mm, 120) == pytest.approx(height_mm, abs=0.01)
        assert rig.stage.state == "idle"
        rig.fail(shows_state="Hold:7")
        with pytest.raises(StageAlarmError):
            rig.stage.move_to(TARGET_MM, 120)
        kinds = ["line [WIFI MAC:...]", "field $Q", "field New", "field SP9", "sub-state Hold:7"]
        passed_over = [note for note in notes(tmp_path) if "passed over" in note]
        assert passed_over == [f"not known, passed over: {kind}" for kind in kinds]

    def test_after_a_hard_limit_the_field_that_says_so_is_noted(
        self, log: _WireLog, tmp_path: Path
    ) -> None:
        struck(log=log).reopen()
        assert "not known, passed over: field $C" in notes(tmp_path)

    def test_noise_does_not_fill_the_log_with_notes(self, log: _WireLog, tmp_path: Path) -> None:
        rig = grbl_rig("grblhal", log=log)
        for number in range(100):
            rig.fail(adds_fields=f"|N{number}:1")
            assert rig.stage.state == "alarm"
        assert len([note for note in notes(tmp_path) if "field N" in note]) <= 32

    @DIALECTS
    @pytest.mark.parametrize(
        "pushed",
        [
            b"[MSG:Warning: supply voltage low]\r\n",
            b">G54:ok\r\n",
            b"[GC:G0 G54 G17 G21 G90 G94 G40 G49 G98 G50 M5 M9 T0 F0 S0.]\r\n",
            b"[TLO:0.000]\r\n",
            b"$N0=G54\r\n",
            "[MSG:Info: Tür]\r\n".encode(),
        ],
    )
    def test_lines_that_nobody_asked_for_disturb_nothing(
        self, dialect: GrblDialect, pushed: bytes
    ) -> None:
        rig = grbl_rig(dialect, connect=False)
        rig.line.faults = LineFaults(after=pushed)
        rig.axis.connect()
        rig.stage.home(120)
        assert_works_again(rig)

    @pytest.mark.parametrize("mask", [511, 510, 511 + 1024, 511 + 4096, 510 + 4096])
    def test_every_choice_of_report_is_read(self, mask: int) -> None:
        rig = homed_grbl("grblhal", settings={10: mask}, work_offset_mm=-37.5)
        assert_works_again(rig)
        assert rig.reopen().is_homed

    @pytest.mark.parametrize("axes", ["XYZA", "XYZABC", "XYZABCUVW"])
    def test_more_axes_than_three_are_passed_over(self, axes: str) -> None:
        rig = homed_grbl("grblhal", axes=axes)
        assert_works_again(rig)

    def test_homing_one_axis_is_told_by_a_mask(self) -> None:
        rig = homed_grbl("grblhal", settings={22: 3}, homing="single_axis")
        assert rig.sent[-1] == "$HZ"
        assert rig.reopen().is_homed
        assert_works_again(rig)


class TestEnvelope:
    @pytest.mark.slow
    @given(
        dialect=st.sampled_from(["grbl", "grblhal"]),
        hard=st.sampled_from([0, 1]),
        inverted=st.sampled_from([0, 4]),
        sets_origin=st.booleans(),
        pull_off_mm=st.sampled_from([0.5, 1.0, 4.0]),
    )
    def test_the_firmware_goes_to_its_ends_and_not_a_step_further(
        self, dialect: GrblDialect, hard: int, inverted: int, sets_origin: bool, pull_off_mm: float
    ) -> None:
        homing = 9 if sets_origin and dialect == "grblhal" else 1
        settings = {20: 1, 21: hard, 22: homing, 23: inverted, 27: pull_off_mm}
        rig = homed_grbl(dialect, settings=settings, boots=False)
        firmware = rig.axis.controller.firmware
        assert firmware is not None
        assert firmware.sets_origin == (homing == 9)
        found = work_envelope(
            rig.firmware.settings,
            rig.config,
            family=firmware.family,
            sets_origin=firmware.sets_origin,
        )
        assert found is not None
        home_mm = found.low_mm if inverted else found.high_mm
        for end_mm, beyond_mm in ((found.low_mm, -0.004), (found.high_mm, 0.004)):
            # Grbl accepts what is nearer to the switch than homing leaves it: an alarm waits there.
            is_open = dialect == "grbl" and found.shortened_at == ("home",) and end_mm == home_mm
            for height_mm, is_accepted in ((end_mm, True), (end_mm + beyond_mm, is_open)):
                line = jog_command("Z", rig.axis.scale.machine_mm(height_mm), 1.0)
                refusal = rig.axis.controller.command(line).error
                assert (refusal is None) == is_accepted
                assert refusal is None or refusal.code == BEYOND_TRAVEL

    def test_limits_beyond_it_are_a_warning_that_says_what_to_change(self) -> None:
        rig = homed_grbl("grblhal", settings={21: 1}, limits_mm=[10.0, 409.0])
        (warning,) = rig.stage.warnings
        for words in ("10.5 to 408.5 mm", "$132 = 400 mm", "$27 = 1 mm", "[10.5, 408.5]"):
            assert words in warning
        with pytest.raises(StageLimitError):
            rig.stage.move_to(409.0, 120)
        assert rig.stage.state == "idle"

    @DIALECTS
    def test_limits_within_it_are_none(self, dialect: GrblDialect) -> None:
        assert homed_grbl(dialect, limits_mm=[10.5, 408.5], settings={21: 1}).stage.warnings == ()


class TestHomingFails:
    @pytest.mark.parametrize(
        ("faults", "code"),
        [
            (PlantFaults(home_switch_stuck=True), 8),
            (PlantFaults(home_switch_dead=True), 9),
        ],
    )
    @DIALECTS
    def test_a_home_switch_at_fault_is_told_with_its_wiring_and_the_pull_off(
        self, dialect: GrblDialect, faults: PlantFaults, code: int
    ) -> None:
        rig = grbl_rig(dialect)
        rig.plant.faults = faults
        with pytest.raises(StageAlarmError) as alarmed:
            rig.stage.home(240)
        assert alarmed.value.code == code
        assert "wiring of the home switch" in str(alarmed.value)
        assert "$27" in str(alarmed.value)
        rig.plant.faults = PlantFaults()
        rig.plant.place(150.0)
        clear_home_and_work(rig)


class TestOldGrbl:
    @pytest.mark.parametrize("boots", [False, True], ids=["running", "reset by opening"])
    def test_grbl_0_9_is_told_with_what_is_needed_instead(self, boots: bool) -> None:
        rig = grbl_rig("grbl 0.9", boots=boots, connect=False)
        with pytest.raises(DeviceProtocolError) as refused:
            rig.axis.connect()
        assert "Grbl 0.9j; Grbl 1.1 is needed: flash Grbl 1.1 or grblHAL" in str(refused.value)
        assert "\n" not in str(refused.value)
        assert set(rig.sent) <= {"$I"}

    def test_a_stop_says_so_too(self) -> None:
        rig = grbl_rig("grbl 0.9", boots=False, connect=False)
        with pytest.raises(DeviceProtocolError) as refused:
            rig.axis.controller.status()
        assert "Grbl 1.1 is needed" in str(refused.value)
        assert rig.sent == []


def test_settings_that_are_texts_are_kept_as_they_are() -> None:
    settings = grbl_rig("grblhal").axis.controller.settings()
    assert (settings[74], settings[75], settings[300]) == ("Werkstatt Süd", "", "Grbl 2")
    assert settings[132] == "400.000"
