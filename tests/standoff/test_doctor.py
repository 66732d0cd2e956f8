import json
import stat
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

import acquisition.aravis
import standoff.doctor
from acquisition.aravis._camera import AravisCamera, CameraProbe, FoundCamera
from acquisition.aravis._device import AravisLibrary
from acquisition.aravis._features import Bounds, StatedValue
from acquisition.aravis._network import NetworkRoute
from acquisition.bench import BenchConfig, StageConfig, load_bench
from acquisition.errors import DriverMissingError
from hil_mocks.gige._settings import GigeFaults
from hil_mocks.practice_bench import PracticeBench
from hil_mocks.stages import SerialStage
from standoff.doctor import (
    Check,
    check_camera,
    check_camera_limits,
    check_disk,
    check_libraries,
    check_mtu,
    check_receive_buffer,
    check_stage_port,
    check_stage_travel,
    examine,
)
from standoff.shipped_configs import shipped_config
from tests.acquisition.aravis_bench import camera_config, needs_aravis
from tests.acquisition.session_fixtures import bench_of
from tests.hil_mocks.gige_bench import gige_bench
from tests.standoff.conftest import Command

PROBE = CameraProbe(
    vendor="Allied Vision",
    model="Manta G-046B",
    name="192.168.10.46",
    is_controllable=True,
    exposure_us=Bounds(low=21.0, high=6e7),
    gain=(
        StatedValue(feature="Gain", value=0.0, unit="dB"),
        StatedValue(feature="Gain", value=31.0, unit="dB"),
    ),
    frame_rate_hz=Bounds(low=0.1, high=67.5),
    pixel_formats=("Mono8", "Mono12"),
    packet_size_bytes=1500,
    temperature_c=None,
)
ROUTE = NetworkRoute(
    address="192.168.10.46", own_address="192.168.10.1", interface="eth1", mtu_bytes=1500
)


@pytest.fixture
def practice_bench() -> Iterator[PracticeBench]:
    with gige_bench() as bench:
        yield bench


def bench_with(address: str, **camera: object) -> BenchConfig:
    return bench_of(driver="aravis", address=address, **camera).model_copy(
        update={"stage": bench_of().stage.model_copy(update={"driver": "manual"})}
    )


def bench_file(folder: Path, address: str) -> Path:
    path = folder / "bench.toml"
    path.write_text(
        f"""
[camera]
driver = "aravis"
address = "{address}"
pixel_format = "Mono12"
exposure_us = 4000.0
gain_db = 0.0
frame_rate_hz = 60.0

[stage]
driver = "manual"
limits_mm = [0.0, 300.0]

[optics]
focal_length_mm = 8.0
pixel_pitch_um = 8.3
"""
    )
    return path


def status_of(checks: tuple[Check, ...], name: str) -> str:
    return next(check.status for check in checks if check.name == name)


def test_missing_libraries_fail_only_a_bench_that_needs_them() -> None:
    def missing() -> AravisLibrary:
        raise DriverMissingError("install gir1.2-aravis-0.8")

    needed = check_libraries(needed=True, load=missing)
    assert (needed.status, needed.remedy) == ("fail", "install gir1.2-aravis-0.8")
    assert check_libraries(needed=False, load=missing).status == "warn"


@pytest.mark.parametrize(
    ("limit_bytes", "status"), [(212992, "warn"), (4194304, "ok"), (None, "warn")]
)
def test_a_small_receive_buffer_is_a_warning_with_the_command_that_mends_it(
    limit_bytes: int | None, status: str
) -> None:
    check = check_receive_buffer(lambda: limit_bytes)
    assert check.status == status
    assert ("4194304" in check.remedy) == (status == "warn")


def test_an_mtu_of_1500_is_a_warning_that_names_the_interface() -> None:
    assert check_mtu(replace(ROUTE, mtu_bytes=9000)).status == "ok"
    small = check_mtu(ROUTE)
    assert small.status == "warn"
    assert "eth1 mtu 9000" in small.remedy


def test_a_camera_in_use_fails() -> None:
    assert check_camera(PROBE).status == "ok"
    assert check_camera(replace(PROBE, is_controllable=False)).status == "fail"


def test_what_the_bench_asks_for_beyond_the_camera_fails_and_names_the_key() -> None:
    good = check_camera_limits(PROBE, camera_config("192.168.10.46"))
    assert {check.status for check in good} == {"ok"}
    assert "no DeviceTemperature" in next(c.found for c in good if c.name == "temperature")
    asked = camera_config("192.168.10.46", exposure_us=10.0, gain_db=40.0, pixel_format="BayerRG12")
    bad = {check.name: check for check in check_camera_limits(PROBE, asked)}
    assert "camera.exposure_us" in bad["exposure"].remedy
    assert "camera.gain_db" in bad["gain"].remedy
    assert "camera.pixel_format" in bad["pixel formats"].remedy
    assert {bad[name].status for name in ("exposure", "gain", "pixel formats")} == {"fail"}


def test_a_pixel_format_that_the_camera_offers_and_nothing_decodes_is_said_to_be_that() -> None:
    asked = camera_config("192.168.10.46", pixel_format="Mono12p")
    for offered, said in (((), "; not Mono12p"), (("Mono12p",), "Mono12p cannot be decoded here")):
        probe = replace(PROBE, undecoded_formats=offered)
        checks = {check.name: check for check in check_camera_limits(probe, asked)}
        assert checks["pixel formats"].status == "fail"
        assert checks["pixel formats"].found.endswith(said)


@pytest.mark.parametrize(
    ("unit", "keys", "status"),
    [
        ("counts", {"gain_db": 0.0}, "ok"),
        ("counts", {"gain_db": 3.0}, "fail"),
        ("counts", {"gain_db": 0.0, "gain_counts": 100}, "ok"),
        ("counts", {"gain_db": 0.0, "gain_counts": 600}, "fail"),
        ("factor", {"gain_db": 54.0}, "ok"),
        ("factor", {"gain_db": 55.0}, "fail"),
        ("dB", {"gain_db": 0.0, "gain_counts": 100}, "fail"),
    ],
)
def test_a_gain_is_judged_in_the_unit_that_the_camera_states_it_in(
    unit: str, keys: dict[str, float], status: str
) -> None:
    low, high = (StatedValue(feature="G", value=value, unit=unit) for value in (1.0, 512.0))
    asked = camera_config("192.168.10.46", **keys)
    checks = check_camera_limits(replace(PROBE, gain=(low, high)), asked)
    assert status_of(checks, "gain") == status  # 512 times is 54.2 dB


def test_a_stage_port_is_there_and_may_be_opened(tmp_path: Path) -> None:
    stage = bench_of().stage
    assert check_stage_port(stage).status == "ok"
    missing = stage.model_copy(update={"port": str(tmp_path / "ttyUSB9")})
    assert check_stage_port(missing).status == "fail"
    (tmp_path / "file").write_text("")
    assert (
        "not a serial port"
        in check_stage_port(stage.model_copy(update={"port": str(tmp_path / "file")})).found
    )
    assert stat.S_ISCHR(Path("/dev/null").stat().st_mode)
    assert check_stage_port(stage.model_copy(update={"port": "/dev/null"})).status == "ok"


def test_a_port_of_another_group_says_which_group_to_join(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.access", lambda *_: False)
    port = bench_of().stage.model_copy(update={"port": "/dev/null"})
    assert "dialout" in check_stage_port(port).remedy


def grbl_stage(low_mm: float, high_mm: float, **expected: float) -> StageConfig:
    """Height 519.5 mm where the controller reads 0; expected settings as ``s27=1.0``."""
    return StageConfig.model_validate(
        {
            "driver": "grbl",
            "port": "/dev/null",
            "limits_mm": [low_mm, high_mm],
            "home_offset_mm": 519.5,
            "expected_settings": {f"${key[1:]}": value for key, value in expected.items()},
        }
    )


# By hand: the travel of 400 mm is 119.5 to 519.5 mm, homing ends 1 mm above its lower end.
@pytest.mark.parametrize(
    ("low_mm", "high_mm", "expected", "status"),
    [
        (120.5, 500.0, {}, "ok"),
        (0.0, 900.0, {"s27": 1.0}, "ok"),
        (120.5, 518.5, {"s27": 1.0, "s132": 400.0}, "ok"),
        (119.5, 519.5, {"s21": 0.0, "s27": 1.0, "s132": 400.0}, "ok"),
        (120.0, 500.0, {"s27": 1.0, "s132": 400.0}, "warn"),
        (120.5, 519.0, {"s21": 1.0, "s23": 4.0, "s27": 1.0, "s132": 400.0}, "warn"),
        (120.0, 500.0, {"s21": 1.0, "s23": 4.0, "s27": 1.0, "s132": 400.0}, "fail"),
        (119.0, 500.0, {"s27": 1.0, "s132": 400.0}, "fail"),
        (120.5, 520.0, {"s21": 0.0, "s27": 1.0, "s132": 400.0}, "fail"),
    ],
)
def test_limits_beyond_the_travel_of_the_expected_settings_are_told(
    low_mm: float, high_mm: float, expected: dict[str, float], status: str
) -> None:
    check = check_stage_travel(grbl_stage(low_mm, high_mm, **expected))
    assert (check.name, check.status) == ("stage travel", status)
    assert bool(check.remedy) == (status != "ok")


def test_a_travel_that_the_pull_off_shortens_is_told_in_numbers_with_what_to_change() -> None:
    expected = {"s21": 1.0, "s23": 4.0, "s27": 1.0, "s132": 400.0}
    check = check_stage_travel(grbl_stage(119.5, 500.0, **expected))
    for words in ("119.5 to 500 mm", "120.5 to 519.5 mm", "$132 = 400 mm", "$27 = 1 mm", "$21=1"):
        assert words in check.found
    assert "limits_mm = [120.5, 500]" in check.remedy
    assert "$27" in check.remedy


def test_settings_that_are_missing_for_the_comparison_are_named() -> None:
    assert "$132" in check_stage_travel(grbl_stage(120.5, 500.0, s27=1.0)).found
    doubtful = check_stage_travel(grbl_stage(120.0, 500.0, s27=1.0, s132=400.0))
    assert "$21 and $23" in doubtful.found


def test_the_shipped_grbl_bench_and_the_stage_that_is_served_for_it_pass(tmp_path: Path) -> None:
    with SerialStage("grbl") as served:
        settings = {"stage.port": served.port, "camera.driver": "files", "camera.address": None}
        bench = load_bench(shipped_config("grbl_stage.toml"), settings)
        checks = {check.name: check for check in examine(bench, tmp_path)}
    assert checks["stage"].status == checks["stage travel"].status == "ok"
    assert "120.5 to 500 mm" in checks["stage travel"].found


@pytest.mark.parametrize(
    ("free_bytes", "status"), [(10**8 - 1, "fail"), (10**9, "warn"), (10**10, "ok")]
)
def test_a_full_disk_is_told_early(tmp_path: Path, free_bytes: int, status: str) -> None:
    assert check_disk(tmp_path, lambda _: free_bytes).status == status


@needs_aravis
def test_a_camera_that_is_ready_passes(practice_bench: PracticeBench, tmp_path: Path) -> None:
    checks = examine(bench_with(practice_bench.camera.address), tmp_path)
    assert {check.status for check in checks} <= {"ok", "warn"}
    assert status_of(checks, "camera") == status_of(checks, "exposure") == "ok"
    assert practice_bench.camera.controller is None


@needs_aravis
def test_a_thermometer_is_read_where_there_is_one(
    practice_bench: PracticeBench, tmp_path: Path
) -> None:
    practice_bench.camera.faults = GigeFaults(temperature_present=True)
    checks = examine(bench_with(practice_bench.camera.address), tmp_path)
    assert "41.5 C" in next(check.found for check in checks if check.name == "temperature")


@needs_aravis
def test_a_camera_in_other_hands_fails_the_command(
    practice_bench: PracticeBench, tmp_path: Path, command: Command
) -> None:
    address = practice_bench.camera.address
    path = bench_file(tmp_path, address)
    command.done("doctor", "--bench", path)
    with closing(AravisCamera.open(camera_config(address))):
        done = command("doctor", "--bench", path)
    assert done.status == 1
    assert "in use by another program" in done.out
    assert "-> close the other program" in done.out


@needs_aravis
@pytest.mark.slow
def test_a_silent_address_fails_in_one_check_of_the_document(
    tmp_path: Path, command: Command
) -> None:
    done = command("doctor", "--bench", bench_file(tmp_path, "127.255.1.1"), "--json")
    assert done.status == 1
    document = json.loads(done.out)
    assert document["ok"] is False
    failed = [check for check in document["checks"] if check["status"] == "fail"]
    assert [check["name"] for check in failed] == ["camera"]


def test_without_a_bench_only_the_computer_is_examined(command: Command) -> None:
    document = json.loads(command("doctor", "--json").out)
    assert [check["name"] for check in document["checks"]] == [
        "libraries",
        "receive buffer",
        "disk",
    ]
    assert command("doctor", "--set", "camera.gain_db=1").status == 2


def test_the_cameras_found_are_listed(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    found = FoundCamera(
        address="10.0.0.7",
        vendor="Allied Vision",
        model="Manta G-046B",
        serial_number="S1",
        hardware_address="00:0f:31:00:00:01",
    )
    monkeypatch.setattr(acquisition.aravis, "list_cameras", lambda: (found,))
    assert "10.0.0.7" in command("cameras").out
    assert json.loads(command("cameras", "--json").out)["cameras"][0]["model"] == "Manta G-046B"
    monkeypatch.setattr(acquisition.aravis, "list_cameras", lambda: ())
    assert "no camera answered" in command("cameras").out


def test_the_help_of_cameras_says_that_it_broadcasts(command: Command) -> None:
    assert "BROADCASTS" in command("cameras", "--help").out


def test_nothing_but_the_command_that_says_so_searches(
    monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    def never() -> tuple[FoundCamera, ...]:
        raise AssertionError("a search was made")

    monkeypatch.setattr(acquisition.aravis, "list_cameras", never)
    command.done("doctor")


def test_a_bench_without_real_devices_has_a_computer_and_a_disk_to_check(tmp_path: Path) -> None:
    checks = examine(bench_of(), tmp_path)
    assert [check.name for check in checks] == [
        "libraries",
        "receive buffer",
        "camera",
        "stage",
        "disk",
    ]
    assert (status_of(checks, "camera"), status_of(checks, "stage")) == ("ok", "ok")
    assert next(c.found for c in checks if c.name == "camera") == "driver 'simulated': no device"


def test_a_port_in_the_network_is_tried_when_it_is_used() -> None:
    stage = bench_of().stage.model_copy(update={"port": "socket://127.0.0.1:7777"})
    check = check_stage_port(stage)
    assert (check.status, check.found) == (
        "ok",
        "socket://127.0.0.1:7777: not checked until it is used",
    )


def test_missing_libraries_are_told_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(_: str) -> CameraProbe:
        raise DriverMissingError("install gir1.2-aravis-0.8")

    monkeypatch.setattr(standoff.doctor, "probe_camera", missing)
    checks = examine(bench_with("127.0.0.1"), tmp_path)
    assert status_of(checks, "network") == "ok"
    assert "camera" not in [check.name for check in checks]
