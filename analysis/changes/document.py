"""The document changes.json: what a comparison of two photographs found, without its images."""

from pathlib import Path
from typing import Final, Literal

from pydantic import Field

from analysis.errors import ResultsFileError
from analysis.results_file import InfiniteAsNull, ResultsDocument
from calibration.documents import read_document
from simulation.choices import PsfForm

CHANGES_SCHEMA: Final = "standoff.changes/1"

_Row3 = tuple[float, float, float]


class ChangeSummary(ResultsDocument):
    """Figures of a comparison of two photographs.

    Parameters
    ----------
    reference, followup
        Names of the photographs.
    homography, distortion_k1, distortion_k1_err, zoom
        Follow-up pixel centres to reference pixel centres, both without distortion; the lens's
        distortion, with its standard error where it was fitted; reference pixels per follow-up
        pixel at the follow-up's centre.
    changed_px, compared_px
        Pixels that changed, of those that were compared.
    threshold_sd, false_alarms_px
        Standard deviations beyond which a pixel counts as changed, and how many of a frame do so
        by chance.
    gain
        Mean of the fitted gain of light.
    extra_blur_px2, extra_blur_err_px2
        Variance by which the follow-up is softer than simulated, and its standard error, infinite
        without any detail; negative: sharper.
    noise_factor, is_noise_known
        Fitted noise variance over that of the noise model; over 1 DN^2 where none was given.
    registration_err_px, width_err_px2
        Standard deviations of the registration along the gradient, and of the variance by which
        the simulated blur is wrong.
    psf_form
        What the shape of the camera's PSF was known as; None in files of before.
    """

    schema_name: Literal["standoff.changes/1"] = Field(default=CHANGES_SCHEMA, alias="schema")
    reference: str = ""
    followup: str = ""
    homography: tuple[_Row3, _Row3, _Row3]
    distortion_k1: float
    distortion_k1_err: float | None
    zoom: float
    changed_px: int
    compared_px: int
    threshold_sd: float
    false_alarms_px: float
    gain: float
    extra_blur_px2: float
    extra_blur_err_px2: InfiniteAsNull
    noise_factor: float
    is_noise_known: bool
    registration_err_px: float
    width_err_px2: float
    psf_form: PsfForm | None = None


def read_changes(path: Path) -> ChangeSummary:
    """Read a changes.json.

    Raises
    ------
    ResultsFileError
        If it cannot be read, is of another schema, or a value is missing or wrong.
    """
    return read_document(path, ChangeSummary, ResultsFileError, "write it with standoff changes")
