"""Boards behind JPEG: edges whose width it hides, and what it does to all of them alike."""

from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from calibration.edges import EdgeImage, JpegCompression
from calibration.psf import calibrate_psf
from calibration.psf.calibration import psf_of_edges
from simulation.arrays import FloatArray
from tests.calibration.psf.consistency.measured_edges import edge
from tests.calibration.squares import chart

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
@pytest.mark.parametrize("quality", [50, 75, 90])
def test_short_edges_of_a_compressed_board_count_and_its_errors_hold_what_all_have_lost(
    quality: int,
) -> None:
    rng = np.random.default_rng(quality)
    for _ in range(3):
        psf = calibrate_psf([compressed(board(rng), quality)])
        assert sum("too_noisy" in edge.flags for edge in psf.edges) == 0
        assert sum(edge.is_used for edge in psf.edges) >= 0.9 * len(psf.edges) >= 100
        for value, err in (
            (psf.optical_sigma_x_px, psf.optical_sigma_x_err_px),
            (psf.optical_sigma_y_px, psf.optical_sigma_y_err_px),
        ):
            assert value is not None
            assert err is not None
            # Of bench_edge_levels' 720 widths the worst was off by 2.6 times its error.
            assert abs(value - SIGMA_PX) < 3.5 * err
            assert err < 0.1 * SIGMA_PX
        assert psf.transfer_2d is not None
        # At quality 50 finer detail has lost more than that: .05 to .07 at .35 cy/px.
        freq = np.array([0.15, 0.25] if quality == 50 else [0.15, 0.25, 0.35])
        zero = np.zeros(freq.size)
        true = np.exp(-2 * np.pi**2 * SIGMA_PX**2 * freq**2) * np.sinc(freq)
        for fx, fy in ((freq, zero), (zero, freq)):
            off = np.abs(psf.transfer_2d.otf(fx, fy) - true)
            assert (off < 3.5 * psf.transfer_2d.otf_err(fx, fy)).all()


def test_jpeg_adds_a_quarter_of_the_mean_error_of_the_edges_to_that_of_a_board() -> None:
    clean = board(np.random.default_rng(1))
    plain = EdgeImage(name="board.tif", image_dn=clean, saturation_dn=255.0)
    marked = EdgeImage(name="board.jpg", image_dn=clean, saturation_dn=255.0, is_jpeg=True)
    first, second = calibrate_psf([plain]), calibrate_psf([marked])
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
    whole = psf_of_edges([one.model_copy(update={"flags": ("jpeg",)}) for one in plain])
    own = psf_of_edges(plain).sigma_x_err_px
    assert own is not None
    assert whole.sigma_x_err_px is not None
    # By hand: weights of 1e4 and 30 of 1/0.15^2 = 44.4, so (100 + 30/0.15) / (1e4 + 1333) = 0.0265.
    assert np.sqrt(whole.sigma_x_err_px**2 - own**2) == pytest.approx(0.25 * 0.0265, rel=0.01)
