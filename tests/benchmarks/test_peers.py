"""Programs that take part in the public benchmark: closed forms, files, runs that broke off."""

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import standoff
from benchmarks.peers.__main__ import programs
from benchmarks.peers.blind import curve_of_kernel
from benchmarks.peers.changes import AlignedPair, pca_kmeans
from benchmarks.peers.depth_changes import flow_difference, stereo_difference
from benchmarks.peers.edges import Curve, fit_gaussian_edge
from benchmarks.peers.mtf_mapper import edges_of, program as mtf_mapper
from benchmarks.peers.ours import moved_pixels
from benchmarks.peers.page import results_page
from benchmarks.peers.program import (
    TRACKS,
    AlignedPoints,
    ChangeScore,
    PeerError,
    Program,
    Task,
    srgb_decoded,
    tasks_of,
)
from benchmarks.peers.run import JOURNAL, Run
from benchmarks.peers.zoom_outs import Frontal
from simulation.arrays import FloatArray
from standoff.library.changes import ComparedPhotographs
from tests.calibration.closed_form import edge_image

NOISE = {"variance_at_black_dn2": 4.0, "variance_per_dn": 0.25}


def task(**facts: object) -> Task:
    known = {"encoding": "linear", "max_level": 4095, "black_level": 64, "noise": NOISE}
    return Task(track="simulation", data=Path(), facts={"task": "t", **known, **facts})


def test_a_gaussian_edge_is_fitted_to_its_width() -> None:
    image = edge_image(0.9, 12.0, low_dn=300.0, high_dn=3000.0)
    # The direction of the line stands at right angles to its normal, told to a degree.
    found = fit_gaussian_edge(image, 12.0 - 90.0 + 0.6, task())
    assert found.sigma_px == pytest.approx(0.9, abs=1e-4)  # to the optimiser's tolerance


def test_the_kernel_between_two_distances_gives_the_psf_behind_it() -> None:
    sigma_px, zoom = 0.8, 2.0
    between = sigma_px * np.sqrt(zoom**2 - 1)  # of Gaussians, variances subtract
    at = np.arange(-12, 13)
    line = np.exp(-0.5 * (at / between) ** 2)
    wide = np.exp(-0.5 * (at / (1.5 * between)) ** 2)
    weights = np.outer(wide, line)
    freq = np.array([0.1, 0.3])
    for axis, sigma in enumerate((sigma_px, 1.5 * sigma_px)):
        curve = curve_of_kernel(weights, zoom, axis)
        made = np.interp(freq, curve.freq, curve.contrast)
        assert made == pytest.approx(np.exp(-2 * (np.pi * sigma * freq) ** 2), abs=2e-3)


def test_half_contrast_is_interpolated_where_it_is_first_reached() -> None:
    freq = np.linspace(0, 1, 11)
    assert Curve(freq=freq, contrast=1 - freq).mtf50 == pytest.approx(0.5)
    assert Curve(freq=freq, contrast=1 - 0.3 * freq).mtf50 is None


def test_codes_of_srgb_become_light() -> None:
    # IEC 61966-2-1: code 188 of 255 is half of the light, to a code's width; both ends stay.
    codes = np.array([0.0, 188 / 255, 1.0])
    assert srgb_decoded(codes) == pytest.approx([0.0, 0.5, 1.0], abs=0.004)


def test_the_box_of_a_frontal_follow_up_is_that_of_its_pixels() -> None:
    matrix = [[2.0, 0, 10.5], [0, 2.0, 4.5], [0, 0, 1]]
    frontal = Frontal.of(
        task(kind="frontal", zoom=2.0, homography_to_reference=matrix, followup_shape=[20, 30])
    )
    # The first pixel covers 10 to 12 along x and 4 to 6 along y, counted from the corner.
    assert frontal.box == pytest.approx((10.0, 4.0, 70.0, 44.0))
    rising = np.add.outer(np.zeros(64), np.arange(90.0))
    assert frontal.sampled(rising)[3, 5:20] == pytest.approx(10.5 + 2 * np.arange(5, 20), abs=1e-6)


def test_a_tilt_is_refused_by_who_knows_none() -> None:
    with pytest.raises(PeerError, match="tilt"):
        Frontal.of(task(kind="tilted"))


MTF_MAPPER = """\
# block_id edge_x edge_y mtf50 corner_x corner_y
1 50.5 20.25 0.3125 40.0 20.0
1 70.0 41.00 0.2875 71.0 31.0
"""


def test_lines_of_mtf_mapper_are_told_by_their_places(tmp_path: Path) -> None:
    (tmp_path / "c1").mkdir()
    path = tmp_path / "c1" / "edge_mtf_values.txt"
    path.write_text(MTF_MAPPER)
    assert edges_of(path) == [(50.5, 20.25, 0.3125), (70.0, 41.0, 0.2875)]
    edges = [
        {"edge": "0", "roi_px": [40, 12, 61, 29], "angle_deg": 5},
        {"edge": "1", "roi_px": [62, 31, 78, 51], "angle_deg": 95},
        {"edge": "2", "roi_px": [0, 0, 9, 9], "angle_deg": 95},
    ]
    chart = Task(track="psf", data=tmp_path, facts={"chart": "c1", "kind": "edges", "edges": edges})
    answers = mtf_mapper(tmp_path).answers["psf"](chart)
    assert isinstance(answers, list)
    assert [(one.edge, one.mtf50) for one in answers] == [("0", 0.3125), ("1", 0.2875)]
    path.write_text("1 50.5 twenty 0.3\n")
    with pytest.raises(PeerError, match="line 1"):
        edges_of(path)


def write_tasks(folder: Path, count: int) -> None:
    (folder / "alignment").mkdir(parents=True)
    tasks = [{"task": f"a{number}", "encoding": "linear"} for number in range(count)]
    document = {"track": "alignment", "tasks": tasks}
    (folder / "alignment" / "tasks.json").write_text(json.dumps(document))


def test_a_run_that_broke_off_goes_on_and_refusals_are_told(tmp_path: Path) -> None:
    write_tasks(tmp_path / "data", 3)
    asked: list[str] = []

    def answer(one: Task) -> AlignedPoints:
        asked.append(one.name)
        if one.name == "a1":
            raise PeerError("too few features")
        return AlignedPoints(homography=np.eye(3))

    program = Program(name="p", given="nothing", answers={"alignment": answer})
    out = tmp_path / "out"
    Run(data=tmp_path / "data", tracks=("alignment",), limit=1).run(program, out)
    assert asked == ["a0"]
    with (out / JOURNAL).open("a") as journal:
        journal.write('{"track": "alignment", "task": "a1", "wal')  # the power failed here
    Run(data=tmp_path / "data", tracks=("alignment",)).run(program, out)
    assert asked == ["a0", "a1", "a2"]
    told = json.loads((out / "alignment.json").read_text())
    assert told["a1"] == {"refused": True}
    assert told["a0"] == told["a2"] == {"homography_to_reference": np.eye(3).tolist()}


def test_programs_have_names_of_their_own_and_say_what_they_were_given() -> None:
    known = programs(Path())
    assert next(iter(known)) == "standoff"
    assert {"mtf-mapper", "kernelgan", "quickmtf", "sfft", "pybsm"} <= set(known)
    assert all(program.given for program in known.values())


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("benchmark") / "tiny"
    standoff.make_benchmark(folder, size="tiny")
    return folder


@pytest.mark.slow
def test_pca_and_k_means_find_a_strong_change_alone(data: Path) -> None:
    plain = next(iter(tasks_of(data, "changes")))

    class Painted(Task):
        def linear(self, key: str) -> FloatArray:
            rng = np.random.default_rng(1)
            image = 1000 + rng.normal(0, 3, (80, 90))
            if key == "followup":
                image[30:38, 50:58] += 300
            return super().linear(key) if key == "chart" else image

    facts = plain.facts | {"homography_to_reference": np.eye(3).tolist()}
    made = pca_kmeans(Painted(track="changes", data=data, facts=facts))
    assert isinstance(made, ChangeScore)
    assert made.places is not None
    [(x_px, y_px)] = made.places
    assert (x_px, y_px) == pytest.approx((53.5, 33.5), abs=1.0)


@pytest.mark.parametrize("peer", [flow_difference, stereo_difference])
def test_stereo_and_flow_follow_a_plate_and_find_a_spot_beside_it(
    peer: Callable[[AlignedPair], FloatArray],
) -> None:
    rng = np.random.default_rng(3)
    ground, plate = (
        1000 + 600 * gaussian_filter(rng.normal(0, 1, (260, 320)), 1.5) for _ in range(2)
    )
    before, after = ground.copy(), ground.copy()
    before[80:180, 112:232] = plate[80:180, 112:232]
    after[80:180, 100:220] = plate[80:180, 112:232]
    y, x = np.indices(ground.shape)
    after += 400 * np.exp(-(np.hypot(y - 50, x - 60) ** 2) / (2 * 2.0**2))
    pair = AlignedPair(
        reference=before,
        followup=after,
        warped=before,
        overlap=np.ones(before.shape, dtype=np.bool_),
        noise_dn=(1.0, 1.0),
        blur_px=(1.0, 1.0),
    )
    found = peer(pair)
    on_plate, plain = found[100:160, 120:200], np.abs(gaussian_filter(after - before, 1.0))
    assert on_plate.mean() < plain[100:160, 120:200].mean() / 5
    spot = found[44:57, 54:67].max()
    assert spot > 150
    assert spot > np.quantile(found[20:70, 20:300], 0.99)


@pytest.mark.slow
def test_every_program_answers_without_the_truth_what_the_scorer_reads(
    data: Path, tmp_path: Path
) -> None:
    known = [one for one in programs().values() if not one.is_slow and one.missing() is None]
    (data / "truth").rename(tmp_path / "truth")
    run = Run(data=data, tracks=TRACKS, limit=4)
    for program in known:
        run.run(program, tmp_path / "results" / program.name)
    (tmp_path / "truth").rename(data / "truth")
    folders = [tmp_path / "results" / program.name for program in known]
    found = standoff.score_benchmark(folders, data)
    for program in known:
        for track in program.answers:
            groups = ("edges", "photographs") if track == "psf" else ("all",)
            assert any(found.score(program.name, track, "answered", one) for one in groups)
    blurred, plain, ours = (
        found.score(name, "simulation", "error_median")
        for name in ("opencv-gaussian", "opencv-cubic", "standoff")
    )
    assert blurred is not None
    assert plain is not None
    assert ours is not None
    assert max(blurred.value, ours.value) < plain.value / 4  # aliasing is most of the error
    page = results_page(tmp_path / "results", found.scores)
    # Of six tables; the pair of photographs has too few pixels for two distances.
    assert page.count("| **standoff** |") == 5
    assert "- **opencv-sift** (opencv" in page


def test_what_stands_out_around_a_movement_is_no_change_and_a_change_beside_it_is() -> None:
    significance = np.zeros((20, 60))
    significance[5:15, 5:20] = 12.0  # moved, with a halo
    significance[5:15, 30:40] = -12.0  # moved, of the other sign, and a change that touches it
    significance[2, 50] = 9.0  # beyond the threshold, and of neither
    moved, changed = np.zeros((2, 20, 60), dtype=np.bool_)
    moved[8:12, 8:16] = moved[8:12, 30:33] = changed[8:12, 36:38] = True
    found = SimpleNamespace(
        significance=significance,
        is_moved=moved,
        is_change=changed,
        summary=SimpleNamespace(threshold_sd=5.0),
    )
    expected = moved.copy()
    expected[5:15, 5:20] = True
    np.testing.assert_array_equal(moved_pixels(cast("ComparedPhotographs", found)), expected)
