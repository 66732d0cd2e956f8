"""Levels, exposure and snapshots of the live picture, as a page asks for them."""

import json
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest
import tifffile

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("httpx2", reason="starlette's test client needs httpx2")


from acquisition.capture import ExposureLimit, FoundExposure
from acquisition.devices import Frame
from acquisition.photographs import read_photograph
from standoff.console.bench_hub import BenchHub
from standoff.console.jobs import BusyError
from standoff.console.web._picture_commands import exposure_sentence, longest_exposure
from standoff.console.web._session_commands import NotInControlError
from standoff.console.web._view_model import state_document
from standoff.errors import ApplicationError
from tests.acquisition.fakes import SETTINGS, frame
from tests.standoff.console.hub_fixtures import idle_hub, running_hub, small_bench, wait_for
from tests.standoff.console.served import page_client
from tests.standoff.console.test_bench_hub import Operator


def test_the_level_of_a_pixel_is_that_of_the_newest_frame(tmp_path: Path) -> None:
    hub = idle_hub(tmp_path)
    Operator(hub)
    watcher = Operator(hub, "Bea")
    asked = {"do": "probe", "x": 3, "y": 2}
    assert watcher.say(**asked) == {"type": "probe", "x": 3, "y": 2, "level_dn": None}
    image_dn = np.arange(24, dtype=np.uint16).reshape(4, 6)
    hub.frames.publish(Frame(image_dn=image_dn, frame_id=1, timestamp_ns=0), SETTINGS)
    assert watcher.say(**asked) == {
        "type": "probe",
        "x": 3,
        "y": 2,
        "level_dn": 15,
        "mean_dn": 12.0,  # of the columns 1 to 5 and the rows 0 to 3: 15 less half a row
        "max_level_dn": 4095,
    }
    profile = watcher.say(do="profile", start=(0.0, 1.0), end=(5.0, 1.0))
    assert profile == {"type": "profile", "length_px": 5.0, "levels_dn": [6, 7, 8, 9, 10, 11]}
    profile = watcher.say(do="profile", start=(0.0, 1.0), end=(6.0, 1.0))
    assert profile == {"type": "profile", "length_px": 0.0, "levels_dn": []}


def test_the_profile_over_the_simulated_edge_rises_from_black_to_white(hub: BenchHub) -> None:
    profile = Operator(hub).say(do="profile", start=(32.0, 4.0), end=(32.0, 44.0))
    assert profile is not None
    levels = profile["levels_dn"]
    assert isinstance(levels, list)
    latest = hub.frames.latest
    assert latest is not None
    above, below = (latest.image_dn[part, 20:44].mean() for part in (slice(4, 14), slice(34, 44)))
    assert abs(above - below) > 1000
    # Of ten pixels each: noise of one is 60 DN at most (11 000 electrons at 5 a DN).
    assert np.mean(levels[:10]) == pytest.approx(above, abs=80)
    assert np.mean(levels[-10:]) == pytest.approx(below, abs=80)


@pytest.mark.slow
@pytest.mark.parametrize("start_us", [60.0, 9000.0, 400_000.0])
def test_the_exposure_is_found_from_dark_and_from_saturated(hub: BenchHub, start_us: float) -> None:
    operator = Operator(hub)
    operator.say(do="exposure", exposure_us=start_us)
    wait_for(lambda: hub.frames.latest.settings.exposure_us == start_us, "the exposure")  # type: ignore[union-attr]
    operator.say(do="auto-exposure")
    operator.wait_idle()
    assert hub.notices[-1].text.startswith("Exposure ")
    found_us = float(hub.notices[-1].text.split()[1])
    seen = hub.frames.latest
    assert seen is not None
    after = seen.sequence + 5
    wait_for(lambda: hub.frames.latest.sequence > after, "pictures after it")  # type: ignore[union-attr]
    latest = hub.frames.latest
    assert latest is not None
    assert latest.settings.exposure_us == found_us
    bright_dn = np.percentile(latest.image_dn, 99.5)
    # The aim is 70 % of the range within 10 %; single frames are noisier than the averages of two.
    assert 0.58 < (bright_dn - 64) / (4095 - 64) < 0.82


def test_a_stop_ends_the_search_and_the_exposure_is_what_it_was(hub: BenchHub) -> None:
    operator = Operator(hub)
    operator.say(do="exposure", exposure_us=60.0)
    wait_for(lambda: hub.frames.latest.settings.exposure_us == 60.0, "the exposure")  # type: ignore[union-attr]
    hub.camera._take_turn()  # the search waits for the camera
    try:
        operator.say(do="auto-exposure")
        with pytest.raises(BusyError):
            operator.say(do="exposure", exposure_us=100.0)
        operator.say(do="stop")
    finally:
        hub.camera._give_turn()
    operator.wait_idle()
    assert hub.notices[-1].text == "Stopped: finding the exposure."
    seen = hub.frames.latest
    assert seen is not None
    wait_for(lambda: hub.frames.latest.sequence > seen.sequence + 3, "pictures again")  # type: ignore[union-attr]
    assert hub.camera.settings is not None
    assert hub.camera.settings.exposure_us == 60.0


@pytest.mark.parametrize(
    ("fraction", "limited_by", "words"),
    [
        (0.7, (), "reach 70 % of the range."),
        (0.5, ("flicker",), "not 70 %, because exposures are whole periods of the mains light"),
        (0.5, ("flicker",), "(10000 µs) and one more would be too bright. Give more light"),
        (0.2, ("longest",), "no longer than a frame takes at camera.frame_rate_hz = 60, and"),
        (0.2, ("longest",), "only 20 % of the range, not 70 %: give more light"),
        (0.2, ("longest", "flicker"), "in whole periods of the mains light (10000 µs), and"),
        (0.9, ("shortest",), "the shortest, and the brightest parts reach 90 % of the range, not"),
        (1.0, ("shortest",), "saturated: close the aperture, or give less light"),
    ],
)
def test_what_was_found_is_told_with_the_reason_and_a_remedy(
    fraction: float, limited_by: tuple[ExposureLimit, ...], words: str
) -> None:
    found = FoundExposure(exposure_us=10_000.0, bright_fraction=fraction, limited_by=limited_by)
    camera = small_bench(camera__frame_rate_hz=60.0, camera__exposure_us=2000.0).camera
    text = exposure_sentence(found, longest=longest_exposure(camera, 60e6), mains_hz=50)
    assert text.startswith("Exposure 10000 µs")
    assert words in text


@pytest.mark.parametrize(
    ("frame_rate_hz", "exposure_us", "high_us", "longest_us", "words"),
    [
        (50.0, 2000.0, 60e6, 20_000.0, "a frame takes"),
        (50.0, 30_000.0, 60e6, 30_000.0, "of the bench file"),
        (50.0, 30_000.0, 10_000.0, 10_000.0, "the camera can expose"),
    ],
)
def test_the_longest_exposure_is_known_with_what_sets_it(
    frame_rate_hz: float, exposure_us: float, high_us: float, longest_us: float, words: str
) -> None:
    bench = small_bench(camera__frame_rate_hz=frame_rate_hz, camera__exposure_us=exposure_us)
    longest = longest_exposure(bench.camera, high_us)
    assert longest.exposure_us == longest_us
    assert words in longest.words


@pytest.mark.slow
@pytest.mark.parametrize(
    ("white_e_per_us", "reason"),
    [
        (0.95, "because exposures are whole periods of the mains light (10000 µs)"),  # 14 ms
        (0.1, "no longer than a frame takes at camera.frame_rate_hz = 60, in whole periods"),
    ],
)
def test_auto_says_what_kept_it_from_seventy_per_cent(
    tmp_path: Path, white_e_per_us: float, reason: str
) -> None:
    keys = {"capture__mains_hz": 50, "simulated__white_e_per_us": white_e_per_us}
    with running_hub(tmp_path, **keys) as hub:
        operator = Operator(hub)
        operator.say(do="auto-exposure")
        operator.wait_idle()
        assert hub.notices[-1].text.startswith("Exposure 10000 µs")
        assert reason in hub.notices[-1].text


def test_the_slider_has_the_limits_of_the_camera(hub: BenchHub) -> None:
    assert state_document(hub)["exposure_limits_us"] == [21.0, 60_000_000.0]


def test_a_snapshot_is_the_newest_frame_with_its_settings(tmp_path: Path) -> None:
    hub = idle_hub(tmp_path)
    operator = Operator(hub)
    with pytest.raises(ApplicationError, match="no picture"):
        operator.say(do="snapshot", frames=1)
    image_dn = np.arange(24, dtype=np.uint16).reshape(4, 6)
    hub.frames.publish(Frame(image_dn=image_dn, frame_id=1, timestamp_ns=0), SETTINGS)
    with pytest.raises(NotInControlError):
        Operator(hub, "Bea").say(do="snapshot", frames=1)
    operator.say(do="snapshot", frames=1)
    name = state_document(hub)["snapshot"]
    assert hub.notices[-1].text == f"Snapshot stored: {name}"
    path = hub.sessions.folder / "snapshots" / name
    np.testing.assert_array_equal(read_photograph(path).stored, image_dn)
    with tifffile.TiffFile(path) as tiff:
        document = json.loads(tiff.pages.first.description)
    assert (document["exposure_us"], document["frames"]) == (2000.0, 1)
    assert (document["operator"], document["height_mm"]) == ("Ada", None)
    assert hub.sessions.summaries() == ()


def test_a_snapshot_of_ten_frames_is_their_mean(hub: BenchHub) -> None:
    operator = Operator(hub)
    operator.say(do="region", region=(2, 3, 20, 30))
    operator.say(do="snapshot", frames=10)
    operator.wait_idle()
    name = hub.snapshots.latest
    stored = read_photograph(hub.sessions.folder / "snapshots" / name).stored
    assert stored.dtype == np.float32
    mean_dn = np.asarray(stored, dtype=np.float64)
    latest = hub.frames.latest
    assert latest is not None
    assert mean_dn.shape == latest.image_dn.shape
    # A frame's noise is 60 DN at white; the difference from the mean has sqrt(1.1) times that.
    assert np.abs(np.mean(mean_dn - latest.image_dn)) < 5 * 1.1 * 60 / np.sqrt(mean_dn.size)
    data = hub.snapshots.read(name)
    assert data is not None
    with tifffile.TiffFile(hub.sessions.folder / "snapshots" / name) as tiff:
        document = json.loads(tiff.pages.first.description)
    assert document["frames"] == 10
    assert document["region_px"] == [2, 3, 20, 30]
    assert document["camera"]["driver"] == "simulated"


def test_a_snapshot_is_served_as_a_file_and_nothing_else_is(tmp_path: Path) -> None:
    hub = idle_hub(tmp_path)
    hub.frames.publish(frame(100, 1), SETTINGS)
    Operator(hub).say(do="snapshot", frames=1)
    (hub.snapshots.folder / "other.tif").write_bytes(b"other")
    with page_client(hub) as client:
        answer = client.get(f"/snapshots/{quote(hub.snapshots.latest)}")
        assert answer.status_code == 200
        assert answer.content == hub.snapshots.read(hub.snapshots.latest)
        assert answer.headers["Content-Type"] == "image/tiff"
        assert answer.headers["Content-Disposition"].startswith("attachment")
        for path in ("other.tif", "..%2Fsnapshots%2Fother.tif", "2025-01-01%2000.00.00.tif"):
            assert client.get(f"/snapshots/{path}").status_code == 404
