"""Results of the simulation are read in a session: their repr is one short line."""

import numpy as np
import pytest

from simulation import (
    GaussianPsf,
    PsfField,
    SampledTransfer,
    SamplingGrid,
    simulate_pose_of_image,
    zoom_operator,
)
from simulation.kernelgan import EstimatedKernel
from simulation.zoom import sr_pairs

PSF = GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.7)
SHAPE = (60, 80)
KERNEL = np.zeros((13, 13))
KERNEL[6, 6] = 1.0


@pytest.mark.parametrize(
    "result",
    [
        PSF,
        PsfField(width_px=80, height_px=60, coefficients_px2=np.array([[0.8], [0.0], [0.5]])),
        SampledTransfer(np.linspace(0, 1, 51), np.linspace(1, 0, 51)),
        SamplingGrid.centred(SHAPE, 2.0),
        simulate_pose_of_image(np.ones(SHAPE), np.eye(3), (80, 60), PSF),
        zoom_operator(SHAPE, SamplingGrid.centred(SHAPE, 2.0), PSF, "paper"),
        EstimatedKernel(weights=KERNEL),
        next(sr_pairs(np.ones(SHAPE), 2.0, PSF, crop_px=40, stride_px=40)),
    ],
    ids=lambda result: type(result).__name__,
)
def test_a_result_is_shown_in_one_short_line(result: object) -> None:
    shown = repr(result)
    assert shown.startswith(type(result).__name__ + "(")
    assert len(shown) < 130
    assert "\n" not in shown


def test_a_zoom_out_shows_the_sizes_of_both_images_width_first() -> None:
    operator = zoom_operator(SHAPE, SamplingGrid.centred(SHAPE, 2.0), PSF)
    assert repr(operator) == "ZoomOperator(80 x 60 to 40 x 30 px)"
