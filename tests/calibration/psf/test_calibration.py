"""Boards behind JPEG: edges whose width it hides, and what it does to all of them alike."""

from dataclasses import replace
from io import BytesIO
from math import sqrt
from typing import Any

import numpy as np
import pytest
from PIL import Image

from calibration.edges import (
    EdgeFit,
    EdgeImage,
    EdgeSelection,
    JpegCompression,
    Region,
    edges_of_image,
    fit_edge,
)
from calibration.errors import NoEdgeError
from calibration.psf import psf_of_images
from calibration.psf._calibration import _psf_of_edges
from simulation.arrays import FloatArray
from tests.calibration.closed_form import edge_image
from tests.calibration.edge_photographs import (
    EIGHT_NORMALS_DEG,
    RHO,
    SIGMA_X_PX,
    SIGMA_Y_PX,
    photographs,
)
from tests.calibration.known import known
from tests.calibration.psf.measured_edges import edge
from tests.calibration.squares import chart


@pytest.mark.slow
@pytest.mark.usefixtures("widths_alone")
def test_a_tilted_lens_behind_square_pixels_is_recovered_from_eight_angles() -> None:
    psf = psf_of_images(photographs(EIGHT_NORMALS_DEG))
    for estimate, truth in (
        (psf.optical.sigma_x_px, SIGMA_X_PX),
        (psf.optical.sigma_y_px, SIGMA_Y_PX),
        (psf.optical.rho, RHO),
    ):
        fitted = known(estimate)
        assert fitted.low <= truth <= fitted.high
    assert known(psf.optical.sigma_x_px).err < 0.003
    assert known(psf.optical.rho).err < 0.01
    assert len(psf.edges_used) == 8
    # Optics and pixel: the square adds 1/12 along either axis, and is no Gaussian (3 %).
    assert psf.sigma_x_px == pytest.approx(sqrt(SIGMA_X_PX**2 + 1 / 12), rel=0.03)
    assert psf.sigma_y_px == pytest.approx(sqrt(SIGMA_Y_PX**2 + 1 / 12), rel=0.03)


@pytest.mark.slow
@pytest.mark.usefixtures("widths_alone")
def test_the_intervals_hold_the_truth_in_19_of_20_calibrations() -> None:
    inside = 0
    for seed in range(40):
        psf = psf_of_images(photographs(EIGHT_NORMALS_DEG, seed))
        for estimate, truth in (
            (psf.optical.sigma_x_px, SIGMA_X_PX),
            (psf.optical.sigma_y_px, SIGMA_Y_PX),
            (psf.optical.rho, RHO),
        ):
            inside += known(estimate).low <= truth <= known(estimate).high
    # 120 draws of probability 0.95 scatter by 2.4 (a little more, being correlated).
    assert inside >= 120 * 0.95 - 3 * 2.4 - 1


def test_a_vertical_edge_alone_leaves_sigma_y_and_rho_open() -> None:
    psf = psf_of_images(photographs([4.0]))
    # The normal lies 4 degrees off the x axis: the width is that of the axis within 4 %.
    assert psf.optical_sigma_x_px == pytest.approx(SIGMA_X_PX, rel=0.04)
    assert psf.sigma_y_px is None
    assert psf.optical_sigma_y_px is None
    assert psf.rho is None
    assert psf.covariance_px2 is None


@pytest.mark.usefixtures("widths_alone")
def test_progress_counts_the_photographs() -> None:
    seen: list[int] = []
    psf_of_images(photographs([4.0, 94.0]), progress=seen.append)
    assert seen == [1, 2]


def test_a_region_restricts_which_edges_count() -> None:
    image = edge_image(0.5, 3.0, shape=(90, 160), offset_px=-30.0)
    source = EdgeImage(name="edge.tif", image_dn=image)
    on_it = Region(x_px=20, y_px=10, width_px=60, height_px=70)
    beside_it = Region(x_px=90, y_px=10, width_px=60, height_px=70)
    assert len(edges_of_image(source, on_it)) == 1
    assert edges_of_image(source, beside_it) == []
    psf = psf_of_images([source], selection=EdgeSelection(region=lambda _: on_it))
    assert psf.edges[0].length_px < 80


def test_places_in_a_region_are_those_of_the_whole_image() -> None:
    image = edge_image(0.5, 3.0, shape=(90, 160), offset_px=-30.0)
    source = EdgeImage(name="edge.tif", image_dn=image)
    [edge] = edges_of_image(source, Region(x_px=20, y_px=15, width_px=60, height_px=50))
    # The line is cos(3) (x - 79.5) + sin(3) (y - 44.5) = -30, the middle of the region y = 39.5.
    assert edge.y_px == pytest.approx(39.5, abs=1.0)
    turn = np.deg2rad(3.0)
    across = np.cos(turn) * (edge.x_px - 79.5) + np.sin(turn) * (edge.y_px - 44.5)
    assert across == pytest.approx(-30.0, abs=0.01)


@pytest.mark.parametrize(
    "region",
    [
        Region(x_px=-1, y_px=0, width_px=20, height_px=20),
        Region(x_px=0, y_px=80, width_px=20, height_px=20),
        Region(x_px=0, y_px=0, width_px=0, height_px=20),
    ],
)
def test_a_region_outside_the_image_is_refused(region: Region) -> None:
    with pytest.raises(ValueError):
        edges_of_image(photographs([4.0])[0], region)


def test_the_central_half_of_an_odd_sized_image_by_hand() -> None:
    centre = Region.centre(90, 111)
    assert (centre.x_px, centre.y_px, centre.width_px, centre.height_px) == (27, 22, 57, 46)


def test_no_edge_at_all_says_what_to_photograph() -> None:
    flat = EdgeImage(name="flat.tif", image_dn=np.full((60, 80), 100.0))
    for sources in ([flat], [flat, flat]):
        with pytest.raises(NoEdgeError) as refused:
            psf_of_images(sources)
        assert (refused.value.found, refused.value.flags) == (0, frozenset())
        assert ("flat.tif" in str(refused.value)) is (len(sources) == 1)


def test_saturated_edges_alone_say_to_shorten_the_exposure() -> None:
    image = np.minimum(edge_image(0.6, 4.0), 45_000.0)
    source = EdgeImage(name="bright.tif", image_dn=image, saturation_dn=45_000.0)
    with pytest.raises(NoEdgeError) as refused:
        psf_of_images([source])
    assert (refused.value.found, refused.value.flags) == (1, frozenset({"saturated"}))
    assert "shorten the exposure" in str(refused.value)


def test_a_saturated_edge_does_not_count_beside_a_good_one() -> None:
    good = photographs([4.0])[0]
    clipped = replace(
        good, name="clipped.tif", image_dn=np.minimum(good.image_dn, 30_000), saturation_dn=30_000.0
    )
    both, alone = psf_of_images([good, clipped]), psf_of_images([good])
    assert both.sigma_x_px == alone.sigma_x_px
    assert [edge.is_used for edge in both.edges] == [True, False]


def test_a_jpeg_is_a_remark_and_no_reason_to_reject() -> None:
    source = replace(photographs([4.0])[0], is_jpeg=True)
    [edge] = psf_of_images([source]).edges
    assert "jpeg" in edge.flags
    assert edge.is_used


def test_an_edge_knows_its_photograph_capture_and_height() -> None:
    source = replace(photographs([94.0])[0], capture=7, height_mm=123.5)
    [edge] = edges_of_image(source)
    assert (edge.image, edge.capture, edge.height_mm) == ("edge-94.tif", 7, 123.5)
    assert edge.orientation == "horizontal"
    # The MTF of the edge's own optical width and pixel: between lens alone and pixel alone.
    assert 0.2 < edge.mtf50_cy_per_px < 0.4


def test_without_photographs_there_is_no_edge() -> None:
    with pytest.raises(NoEdgeError) as refused:
        psf_of_images([])
    assert refused.value.found == 0


@pytest.mark.parametrize(("optical_only", "edges"), [(False, 0), (True, 1)])
def test_a_width_less_sure_than_itself_is_no_width(
    monkeypatch: pytest.MonkeyPatch, optical_only: bool, edges: int
) -> None:
    def unsure(*args: Any, **options: Any) -> EdgeFit | None:
        fit = known(fit_edge(*args, **options))
        infinite = replace(fit, optical_sigma_err_px=np.inf)
        return infinite if optical_only else replace(infinite, sigma_err_px=np.inf)

    monkeypatch.setattr("calibration.edges.measurement.fit_edge", unsure)
    found = edges_of_image(photographs([4.0])[0])
    assert len(found) == edges
    assert all(edge.optical_sigma_px is None for edge in found)


SIGMA_PX = 0.7  # of the lens
ROWS, COLS = 300, 380


def board(rng: np.random.Generator) -> FloatArray:
    """Dark squares of 26 px in closed form, with noise of .8 DN, in DN."""
    turn_deg = float(rng.uniform(-10.0, 10.0))
    cover = chart(ROWS, COLS, pitch_px=44.0, side_px=26.0, turn_deg=turn_deg, sigma_px=SIGMA_PX)
    return 190.0 - 140.0 * cover + rng.normal(0.0, 0.8, cover.shape)


def compressed(image_dn: FloatArray, quality: int) -> EdgeImage:
    data = BytesIO()
    Image.fromarray(np.rint(image_dn).astype(np.uint8)).save(data, "JPEG", quality=quality)
    with Image.open(data) as opened:
        steps = np.array(opened.quantization[0], dtype=np.float64).reshape(8, 8)  # type: ignore[attr-defined]  # JPEG's own
        levels = np.asarray(opened, dtype=np.float64)
    return EdgeImage(
        name="board.jpg",
        image_dn=levels,
        saturation_dn=255.0,
        is_jpeg=True,
        compression=JpegCompression(steps=steps, code_levels_dn=np.arange(256.0)),
    )


@pytest.mark.slow
@pytest.mark.parametrize(("quality", "seed"), [(50, 51), (75, 75), (90, 90)])
def test_short_edges_of_a_compressed_board_count_and_its_errors_hold_what_all_have_lost(
    quality: int, seed: int
) -> None:
    psf = psf_of_images([compressed(board(np.random.default_rng(seed)), quality)])
    assert sum("too_noisy" in edge.flags for edge in psf.edges) == 0
    assert sum(edge.is_used for edge in psf.edges) >= 0.9 * len(psf.edges) >= 100
    for value, err in (
        (psf.optical_sigma_x_px, psf.optical_sigma_x_err_px),
        (psf.optical_sigma_y_px, psf.optical_sigma_y_err_px),
    ):
        assert value is not None
        assert err is not None
        # Of 720 widths of benchmarks/studies/edge_levels.py the worst was off by 2.6 times that.
        assert abs(value - SIGMA_PX) < 3.5 * err
        assert err < 0.1 * SIGMA_PX
    assert psf.transfer_2d is not None
    # At quality 50 finer detail has lost more than that: .05 to .07 at .35 cy/px. At 75 it has for
    # the one board in three whose blocks ask for a form other than the Gaussian: 5 of its errors.
    freq = np.array([0.15, 0.25] if quality == 50 else [0.15, 0.25, 0.35])
    zero = np.zeros(freq.size)
    true = np.exp(-2 * np.pi**2 * SIGMA_PX**2 * freq**2) * np.sinc(freq)
    for fx, fy in ((freq, zero), (zero, freq)):
        off = np.abs(psf.transfer_2d.otf(fx, fy) - true)
        assert (off < 3.5 * psf.transfer_2d.otf_err(fx, fy)).all()


@pytest.mark.slow
@pytest.mark.usefixtures("widths_alone")
def test_jpeg_adds_a_quarter_of_the_mean_error_of_the_edges_to_that_of_a_board() -> None:
    clean = board(np.random.default_rng(1))
    plain = EdgeImage(name="board.tif", image_dn=clean, saturation_dn=255.0)
    marked = EdgeImage(name="board.jpg", image_dn=clean, saturation_dn=255.0, is_jpeg=True)
    first, second = psf_of_images([plain]), psf_of_images([marked])
    assert first.sigma_x_px == second.sigma_x_px
    assert first.sigma_x_err_px is not None
    assert second.sigma_x_err_px is not None
    relative = np.array([e.sigma_err_px / e.sigma_px for e in second.edges if e.is_used])
    mean = np.sum(1 / relative) / np.sum(1 / relative**2)  # weighted as the edges are
    own, whole = first.sigma_x_err_px, second.sigma_x_err_px
    assert second.sigma_x_px is not None
    assert np.sqrt(whole**2 - own**2) == pytest.approx(0.25 * mean * second.sigma_x_px, rel=0.02)


def test_short_edges_beside_one_that_decides_do_not_decide_what_is_lost() -> None:
    errs = [0.01] + 30 * [0.15]
    angles = [85.0, 95.0] * 16
    plain = [
        edge(sigma_px=1.0, angle_deg=angle).model_copy(update={"sigma_err_px": err})
        for angle, err in zip(angles, errs, strict=False)
    ]
    whole = _psf_of_edges([one.model_copy(update={"flags": ("jpeg",)}) for one in plain])
    own = known(_psf_of_edges(plain).sigma_x_err_px)
    assert whole.sigma_x_err_px is not None
    # By hand: weights of 1e4 and 30 of 1/0.15^2 = 44.4, so (100 + 30/0.15) / (1e4 + 1333) = 0.0265.
    assert np.sqrt(whole.sigma_x_err_px**2 - own**2) == pytest.approx(0.25 * 0.0265, rel=0.01)
