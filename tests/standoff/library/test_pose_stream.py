"""`standoff pose --stream` and `--bench`: verdicts as they come."""

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import tifffile

from acquisition.focus._live import newest_frames
from analysis.detectability._curves import DetectabilityCurves
from analysis.results_file import write_results
from hil_mocks import SimulatedBench
from hil_mocks.devices import CameraFaults
from standoff.terminal._options import read_bench
from tests.acquisition.aravis_bench import needs_aravis
from tests.analysis.detectability.test_curves import curve
from tests.calibration.registration.test_tracking import pose, scene, seen_from
from tests.hil_mocks.gige_bench import gige_bench
from tests.standoff.commands.test_focus import REAL_CAMERA
from tests.standoff.conftest import Command


@pytest.fixture
def asked(tmp_path: Path) -> tuple[object, ...]:
    tifffile.imwrite(tmp_path / "reference.tif", scene().astype(np.float32))
    write_results(tmp_path / "curves.json", DetectabilityCurves(curves=[curve()]))
    return (
        *("pose", tmp_path / "reference.tif", "--curves", tmp_path / "curves.json"),
        *("--min-dprime", 3.2),
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "live"
    path.mkdir()
    for number, zoom in enumerate((1.05, 1.1, 1.2)):
        write(path, number, zoom)
    return path


def write(folder: Path, number: int, zoom: float) -> None:
    image = seen_from(scene(), pose(zoom)).astype(np.float32)
    tifffile.imwrite(folder / f"frame-{number}.tif", image)


def test_every_image_of_a_folder_has_its_verdict(
    command: Command, asked: tuple[object, ...], folder: Path
) -> None:
    done = command.done(*asked, "--stream", folder)
    lines = done.out.splitlines()
    assert [line.split()[:2] for line in lines[:3]] == [
        ["frame-0.tif", "accept"],
        ["frame-1.tif", "accept"],
        ["frame-2.tif", "reject"],
    ]
    assert lines[3].startswith("2 of 3 frames accepted; full-frame searches: 1")


def test_the_summary_is_one_json_document(
    command: Command, asked: tuple[object, ...], folder: Path
) -> None:
    document = command.document(*asked, "--stream", folder, "--frames", 2)
    assert (document["frames"], document["accepted"], document["lost"]) == (2, 2, 0)
    assert document["anchors"] == 1
    assert [verdict["frame"] for verdict in document["verdicts"]] == ["frame-0.tif", "frame-1.tif"]
    # Straight back by 1.1: d' of the curve there is 4 / (2 z - 1).
    assert document["last"]["dprime_decisive"] == pytest.approx(10 / 3, abs=0.05)
    assert document["last"]["margin"] == pytest.approx(10 / 3 / 3.2 - 1, abs=0.02)


def test_a_watched_folder_is_read_until_ctrl_c(
    command: Command, asked: tuple[object, ...], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits: Iterator[int] = iter(range(3))

    def wait(_: float) -> None:
        number = next(waits)
        if number == 0:
            (folder / "frame-9.tif").write_bytes(b"II*\0half")  # still being written
        elif number == 1:
            write(folder, 9, 1.05)
        else:
            raise KeyboardInterrupt

    monkeypatch.setattr("standoff.library.pose_stream.time.sleep", wait)
    done = command(*asked, "--stream", folder, "--watch", "--json")
    assert done.status == 130
    assert json.loads(done.out)["frames"] == 4


@pytest.mark.slow
def test_a_camera_is_judged_frame_by_frame(
    command: Command, bench_file: Path, tmp_path: Path
) -> None:
    keys = ["simulated.width_px=260", "simulated.height_px=200", "optics.pixel_pitch_um=24.0"]
    bench = SimulatedBench(read_bench(bench_file, keys))
    bench.place("coins")
    tifffile.imwrite(tmp_path / "reference.tif", next(newest_frames(bench.camera)).image_dn)
    write_results(tmp_path / "curves.json", DetectabilityCurves(curves=[curve()]))
    asked = ("pose", tmp_path / "reference.tif", "--curves", tmp_path / "curves.json")
    live = ("--bench", bench_file, "--target", "coins", "--frames", 3, "--json")
    settings = (part for key in keys for part in ("--set", key))
    done = command.done(*asked, "--min-dprime", 3, *live, *settings)
    document = json.loads(done.out)
    assert (document["frames"], document["accepted"]) == (3, 3)
    assert document["last"]["zoom"] == pytest.approx(1.0, abs=0.01)
    assert "accept" in done.err


def test_the_newest_frame_is_given_and_incomplete_ones_are_left_out(bench_file: Path) -> None:
    bench = SimulatedBench(read_bench(bench_file, None))
    bench.camera.faults = CameraFaults(incomplete_frames=frozenset({1}))
    frames = newest_frames(bench.camera)
    found = [next(frames).frame_id for _ in range(3)]
    frames.close()
    assert found == sorted(set(found))
    assert 2 not in found
    bench.camera.start()  # it was stopped


def test_a_folder_without_images_and_one_that_is_too_small_are_one_line(
    command: Command, asked: tuple[object, ...], tmp_path: Path
) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    done = command(*asked, "--stream", empty)
    assert (done.status, "contains no image" in done.err) == (1, True)
    tifffile.imwrite(empty / "tiny.tif", np.eye(20, dtype=np.float32))
    done = command(*asked, "--stream", empty)
    assert done.status == 1
    assert "tiny.tif: tracking needs grey images of at least 84 px" in done.err


def test_a_reference_that_cannot_be_followed_is_named_before_any_frame(
    command: Command, asked: tuple[object, ...], folder: Path, tmp_path: Path
) -> None:
    tifffile.imwrite(tmp_path / "reference.tif", np.full((200, 260), 700, np.uint16))
    done = command(*asked, "--stream", folder)
    assert (done.status, done.out) == (1, "")
    assert f"{tmp_path / 'reference.tif'}: " in done.err
    assert done.err.count("\n") == 1


def test_an_image_that_stays_broken_in_a_watched_folder_ends_the_watch(
    command: Command, asked: tuple[object, ...], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("standoff.library.pose_stream.time.sleep", lambda _: None)
    (folder / "frame-9.tif").write_bytes(b"II*\0half")  # and grows no more
    done = command(*asked, "--stream", folder, "--watch", "--json")
    assert done.status == 1
    assert "frame-9.tif: not a complete TIFF image" in done.err
    assert json.loads(done.out)["frames"] == 3  # those that were whole were judged


def test_a_watched_folder_that_is_taken_away_ends_the_watch_in_one_line(
    command: Command, asked: tuple[object, ...], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("standoff.library.pose_stream.time.sleep", lambda _: shutil.rmtree(folder))
    done = command(*asked, "--stream", folder, "--watch", "--json")
    assert done.status == 1
    assert f"cannot read the folder {folder}: No such file or directory" in done.err
    assert done.err.count("\n") == 1
    assert json.loads(done.out)["frames"] == 3


def test_what_lies_beyond_the_curve_is_told_and_counts_as_unseen(
    command: Command, asked: tuple[object, ...], tmp_path: Path
) -> None:
    far = tmp_path / "far.tif"
    beyond = curve().zoom[-1] * 1.1
    tifffile.imwrite(far, seen_from(scene(), pose(beyond)).astype(np.float32))
    done = command.done(*asked, far)
    assert f"100 % of the overlap lies beyond the curve's zoom of {curve().zoom[-1]:g}" in done.err
    assert done.out.startswith("rejected: min d' 0.00, threshold 3.2")


@pytest.mark.slow
@needs_aravis
def test_a_real_cameras_frames_are_judged_by_their_numbers(
    command: Command, asked: tuple[object, ...], tmp_path: Path
) -> None:
    path = tmp_path / "real.toml"
    with gige_bench() as practice:
        path.write_text(REAL_CAMERA.format(address=practice.camera.address))
        words = (*asked, "--bench", path, "--frames", 2)
        refused = command(*words, "--target", "coins")
        assert refused.status == 2
        assert "only a simulated bench takes a target" in refused.err
        # Frames of 96 x 64 px are too small to be followed: the first one is named.
        done = command(*words)
        assert "camera.frame_rate_hz" in done.err
        assert done.status == 1
        assert re.search(r"frame \d+: tracking needs grey images of at least 84 px", done.err)
        assert practice.camera.controller is None
