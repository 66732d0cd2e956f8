import numpy as np
import pytest

from calibration.edges import EdgeImage, mean_transfer
from calibration.errors import PsfFileError
from calibration.psf import PsfCalibration, calibrate_psf
from tests.calibration.closed_form import edge_image


def calibrated(*normals_deg: float) -> PsfCalibration:
    sources = [
        EdgeImage(name=f"{n:g}", image_dn=edge_image(0.7 if n < 45 else 0.5, n, has_pixel=True))
        for n in normals_deg
    ]
    return calibrate_psf(sources)


def test_the_measured_transfer_is_the_product_of_lens_and_pixel() -> None:
    transfer = calibrated(2.0, 92.0).measured_transfer("psf.json")
    freq = np.linspace(0, 1, 21)
    for along, sigma in ((transfer.along_x, 0.7), (transfer.along_y, 0.5)):
        truth = np.exp(-2 * (np.pi * sigma * freq) ** 2) * np.sinc(freq)
        # 2 degrees off the axis the square is hardly another one.
        np.testing.assert_allclose(along(freq), truth, atol=2e-3)


def test_an_axis_without_edges_has_no_transfer() -> None:
    for psf in (calibrated(2.0), PsfCalibration(sigma_x_px=0.8)):
        with pytest.raises(PsfFileError) as refused:
            psf.measured_transfer("lens.json")
        assert (refused.value.source, refused.value.key) == ("lens.json", "transfer.y")
    assert mean_transfer([]) is None


def test_samples_that_are_no_transfer_function_are_refused() -> None:
    curve = {"freq_cy_per_px": [0.0, 0.3], "mtf": [1.0, 0.5]}
    psf = PsfCalibration.model_validate({"transfer": {"x": curve, "y": curve}})
    with pytest.raises(PsfFileError) as refused:
        psf.measured_transfer("lens.json")
    assert (refused.value.source, refused.value.key) == ("lens.json", "transfer.y")
