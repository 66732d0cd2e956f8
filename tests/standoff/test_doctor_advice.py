"""What the doctor advises on each kind of error that a camera can end in."""

from pathlib import Path

import pytest

from acquisition import errors
from acquisition.errors import (
    CameraDescriptionError,
    CameraFeatureError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceInUseError,
    DeviceProtocolError,
    DeviceRefusalError,
    DeviceTimeoutError,
    MissingFeatureError,
    NoRouteError,
)
from hil_mocks.gige._settings import GigeFaults
from standoff.doctor import Check, advice_on, examine
from tests.acquisition.aravis.description_texts import simulated
from tests.acquisition.aravis_bench import needs_aravis
from tests.hil_mocks.gige_bench import gige_bench
from tests.standoff.test_doctor import bench_with

CABLE = "check power, cable and firewall"

ADVICE: list[tuple[DeviceError, str]] = [
    (DeviceDisconnectedError("silent"), CABLE),
    (DeviceTimeoutError("late", timeout_s=1.0), CABLE),
    (NoRouteError("none", address="10.0.0.7"), "in the subnet of 10.0.0.7"),
    (DeviceInUseError("held"), "close the other program"),
    (MissingFeatureError("none", names=("ExposureTime", "ExposureTimeAbs")), "use another camera"),
    (MissingFeatureError("none", names=("TriggerMode",)), "leave that out of the bench file"),
    (MissingFeatureError("none", names=("Odd",)), "lacks Odd"),
    (CameraFeatureError("no", feature="PixelFormat"), "camera.pixel_format"),
    (CameraFeatureError("no", feature="AcquisitionFrameRateAbs"), "camera.frame_rate_hz"),
    (
        CameraFeatureError("no", feature="GammaEnable"),
        "set GammaEnable to a possible value in the maker's viewer",
    ),
    (CameraFeatureError("no", feature="the stream channel"), "switch the camera off and on again"),
    (CameraDescriptionError("odd", fault="circle"), "install the maker's firmware"),
    (DeviceProtocolError("odd"), "switch the camera off and on again"),
    (DeviceRefusalError("no", code=3), "switch the camera off and on again"),
    (DeviceError("camera.address: the host name cannot be resolved"), "correct camera.address"),
]


@pytest.mark.parametrize(("error", "advice"), ADVICE, ids=lambda given: type(given).__name__)
def test_each_kind_of_error_has_its_own_advice(error: DeviceError, advice: str) -> None:
    assert advice in advice_on(error)
    assert (CABLE in advice_on(error)) == (advice == CABLE)


def test_no_kind_of_error_that_a_camera_raises_is_left_out() -> None:
    kinds = {
        kind
        for kind in vars(errors).values()
        if isinstance(kind, type)
        and issubclass(kind, DeviceError)
        and not kind.__name__.startswith(("Stage", "Operator", "Capture", "Driver"))
    }
    of_a_stage_or_a_stream = {"StreamInterruptedError", "DeviceSettingsError", "DeviceResetError"}
    covered = {type(error).__name__ for error, _ in ADVICE} | of_a_stage_or_a_stream
    assert {kind.__name__ for kind in kinds} <= covered


def camera_check(checks: tuple[Check, ...], name: str = "camera") -> Check:
    return next(check for check in checks if check.name == name)


@needs_aravis
def test_a_camera_that_lacks_a_feature_is_told_by_the_feature_and_its_model_not_by_the_cable(
    tmp_path: Path,
) -> None:
    with gige_bench() as bench:
        text = simulated().replace(b'Name="ExposureTimeAbs"', b'Name="ShutterSpeed"')
        bench.camera.serve_description(text)
        check = camera_check(examine(bench_with(bench.camera.address), tmp_path))
    assert check.status == "fail"
    assert "standoff Simulated Manta G-046B has no feature ExposureTime" in check.found
    assert check.remedy == ("this camera model cannot set camera.exposure_us: use another camera")


@needs_aravis
def test_a_camera_without_pixel_formats_is_told_by_that(tmp_path: Path) -> None:
    with gige_bench() as bench:
        bench.camera.serve_description(simulated().replace(b'"PixelFormat"', b'"PixelForm"'))
        check = camera_check(examine(bench_with(bench.camera.address), tmp_path))
    assert "no feature PixelFormat" in check.found
    assert "camera.pixel_format" in check.remedy


@needs_aravis
def test_a_register_that_the_camera_does_not_read_is_told_by_its_feature(tmp_path: Path) -> None:
    with gige_bench() as bench:
        text = simulated()
        place = text.index(b'<FloatReg Name="ExposureTimeAbsReg"><Address>')
        address = text.index(b"0x", place)
        odd = text[:address] + b"0x70000000" + text[text.index(b"<", address) :]
        bench.camera.serve_description(
            odd.replace(b"<Min>21</Min>", b"<pMin>ExposureTimeAbsReg</pMin>")
        )
        check = camera_check(examine(bench_with(bench.camera.address), tmp_path))
    assert check.status == "fail"
    assert "camera.exposure_us" in check.remedy


@needs_aravis
@pytest.mark.slow
@pytest.mark.waits
def test_a_camera_that_is_off_is_still_told_to_be_looked_after(tmp_path: Path) -> None:
    with gige_bench() as bench:
        bench.camera.faults = GigeFaults(is_dead=True)
        check = camera_check(examine(bench_with(bench.camera.address), tmp_path))
    assert CABLE in check.remedy


def test_an_address_that_nothing_leads_to_is_a_matter_of_this_computers_card(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_route(address: str) -> object:
        raise NoRouteError(f"no network interface leads to {address}", address=address)

    monkeypatch.setattr("standoff.doctor.route_to", no_route)
    check = camera_check(examine(bench_with("10.0.0.7"), tmp_path), "network")
    assert "give the network card an address" in check.remedy


@needs_aravis
@pytest.mark.parametrize("is_resent", [True, False])
def test_a_camera_that_does_not_resend_packets_is_a_warning(
    tmp_path: Path, is_resent: bool
) -> None:
    with gige_bench() as bench:
        bench.camera.faults = GigeFaults(resend_disabled=not is_resent)
        check = camera_check(examine(bench_with(bench.camera.address), tmp_path), "packet resend")
    assert check.status == ("ok" if is_resent else "warn")
    assert bool(check.remedy) != is_resent
