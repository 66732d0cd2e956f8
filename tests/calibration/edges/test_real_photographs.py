"""Edges that a real camera photographed; the folder is named by STANDOFF_REAL_DATA."""

import os
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from calibration.edges.gaussian_mtf import gaussian_mtf50
from calibration.edges.measurement import EdgeImage, Method, measure_edges
from calibration.psf.calibration import calibrate_psf
from calibration.psf.document import PsfCalibration
from calibration.psf.linearise import luma_plane

FOLDER = os.environ.get("STANDOFF_REAL_DATA")

pytestmark = pytest.mark.skipif(
    FOLDER is None, reason="STANDOFF_REAL_DATA does not name a folder of real photographs"
)

# Three independent estimators agree on this width of the photographed slanted edge: maximum
# likelihood on raw pixels, a P-spline and MTF Mapper.
TOTAL_SIGMA_PX = 0.935


def calibrated(name: str, method: Method = "all-angles") -> PsfCalibration:
    assert FOLDER is not None
    image = luma_plane(tifffile.imread(Path(FOLDER) / "edges" / name))
    return calibrate_psf([EdgeImage(name=name, image_dn=image, saturation_dn=255.0)], method=method)


def test_the_photographed_vertical_edge_gives_sigma_x_alone() -> None:
    psf = calibrated("v_edge.tif")
    assert psf.sigma_x_px == pytest.approx(TOTAL_SIGMA_PX, abs=0.005)
    assert psf.sigma_y_px is None
    assert psf.rho is None


def test_the_photographed_horizontal_edge_gives_sigma_y_alone() -> None:
    psf = calibrated("h_edge.tif")
    assert psf.sigma_y_px == pytest.approx(TOTAL_SIGMA_PX, abs=0.005)
    assert psf.sigma_x_px is None
    assert psf.rho is None


def test_the_papers_way_gives_what_binning_with_an_lsf_fit_gave_elsewhere() -> None:
    psf = calibrated("v_edge.tif", "paper")
    # An independent program, binning and fitting the line spread function: 0.981 px.
    assert psf.sigma_x_px == pytest.approx(0.981, abs=0.003)


def test_the_measured_contrast_of_the_photographed_edge_is_near_that_of_its_gaussian() -> None:
    for edge in calibrated("v_edge.tif").edges:
        assert edge.esfr is not None
        # The profile is flagged as not quite Gaussian: 2 %.
        assert edge.esfr.mtf50_cy_per_px == pytest.approx(gaussian_mtf50(TOTAL_SIGMA_PX), rel=0.02)


@pytest.mark.slow
def test_photographed_chessboards_give_their_widths_and_sixty_edges_each() -> None:
    assert FOLDER is not None
    widths: dict[str, list[float]] = {"vertical": [], "horizontal": [], "diagonal": []}
    for path in sorted((Path(FOLDER) / "chessboards").glob("*.jpg")):
        image = np.asarray(Image.open(path), dtype=np.float64)
        source = EdgeImage(name=path.name, image_dn=image, saturation_dn=255.0, is_jpeg=True)
        used = [edge for edge in measure_edges(source) if edge.is_used]
        assert len(used) >= 60, path.name
        for edge in used:
            widths[edge.orientation].append(edge.sigma_px)
    # Medians over all photographs by another program; single ones lie between 0.67 and 1.00.
    assert np.median(widths["vertical"]) == pytest.approx(0.85, rel=0.05)
    assert np.median(widths["horizontal"]) == pytest.approx(0.79, rel=0.05)
