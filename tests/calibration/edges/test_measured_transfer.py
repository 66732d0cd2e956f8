import numpy as np
import pytest

from calibration.edges.esfr import mean_transfer
from calibration.errors import PsfFileError
from calibration.files import psf_document
from calibration.psf.calibration import EdgeImage, calibrate_psf
from calibration.psf.document import StoredPsf
from tests.calibration.closed_form import edge_image


def stored(*normals_deg: float) -> StoredPsf:
    sources = [
        EdgeImage(name=f"{n:g}", image_dn=edge_image(0.7 if n < 45 else 0.5, n, has_pixel=True))
        for n in normals_deg
    ]
    return StoredPsf.model_validate(psf_document(calibrate_psf(sources)))


def test_the_measured_transfer_is_the_product_of_lens_and_pixel() -> None:
    transfer = stored(2.0, 92.0).measured_transfer("psf.json")
    freq = np.linspace(0, 1, 21)
    for along, sigma in ((transfer.along_x, 0.7), (transfer.along_y, 0.5)):
        truth = np.exp(-2 * (np.pi * sigma * freq) ** 2) * np.sinc(freq)
        # 2 degrees off the axis the square is hardly another one.
        np.testing.assert_allclose(along(freq), truth, atol=2e-3)


def test_an_axis_without_edges_has_no_transfer() -> None:
    with pytest.raises(PsfFileError, match=r"lens\.json: it holds no transfer function along y"):
        stored(2.0).measured_transfer("lens.json")
    with pytest.raises(PsfFileError, match="no transfer function along y"):
        StoredPsf(sigma_x_px=0.8).measured_transfer("psf.json")
    assert mean_transfer([]) is None


def test_samples_that_are_no_transfer_function_are_refused() -> None:
    curve = {"freq_cy_per_px": [0.0, 0.3], "mtf": [1.0, 0.5]}
    psf = StoredPsf.model_validate({"transfer": {"x": curve, "y": curve}})
    with pytest.raises(PsfFileError, match=r"psf\.json: transfer\.y: frequencies must rise"):
        psf.measured_transfer("psf.json")
