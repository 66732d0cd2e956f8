"""The document changes.json: what a comparison of two photographs found, without its images."""

import csv
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from pydantic import Field

from acquisition.dataframe import dataframe
from analysis.errors import ResultsFileError
from analysis.results_file import InfiniteAsNull, ResultsDocument, StoredValues
from calibration.documents import read_document
from simulation.choices import PsfForm

if TYPE_CHECKING:
    from pandas import DataFrame

CHANGES_SCHEMA: Final = "standoff.changes/1"

KernelOrigin = Literal["calibrated", "pair", "both"]
"""Where the blur between two photographs is known from: psf.json, themselves, or both."""

_Row3 = tuple[float, float, float]


class Change(StoredValues):
    """One connected change of one sign, at its strongest place.

    A thing that moved is two changes: what vanished, and what appeared.

    Parameters
    ----------
    x_px, y_px, reference_x_px, reference_y_px
        Its place in the follow-up and in the reference; 0 at the centre of the first pixel.
    area_px
        Follow-up pixels beyond the threshold.
    amplitude_dn, amplitude_err_dn
        Peak of the change, after minus before, in the follow-up's levels, as the coarser of the two
        photographs shows it, and its standard error.
    significance
        Standard deviations by which its strongest place stands out from chance; positive.
    q_value
        Share of false ones expected among the changes that are at least as significant.
    spot_sigma_px
        Width of the Gaussian spot that fits best, in follow-up pixels; None in files of before.
    """

    x_px: float
    y_px: float
    reference_x_px: float
    reference_y_px: float
    area_px: float
    amplitude_dn: float
    amplitude_err_dn: float
    significance: float
    q_value: float
    spot_sigma_px: float | None = None


class SpotLimit(StoredValues):
    """Amplitude at which Gaussian spots of one width are found, over the compared pixels.

    Parameters
    ----------
    spot_sigma_px, spot_sigma_mm
        Width of the spot as the follow-up shows it, in its pixels and, if their size is known, mm.
    median_dn, p95_dn, worst_dn
        Limit in the follow-up's levels: at half of the pixels it is lower than the first, at 95 %
        lower than the second, and nowhere higher than the third.
    reached_fraction
        Share of the compared pixels where the limit is below a contrast that was asked about.
    """

    spot_sigma_px: float
    median_dn: float
    p95_dn: float
    worst_dn: float
    reached_fraction: float | None = None
    spot_sigma_mm: float | None = None


class PredictedLimit(StoredValues):
    """A limit that was predicted, and the one that a pair shows of the same change of the scene.

    Parameters
    ----------
    spot_sigma_px
        Width with which a follow-up as sharp as predicted shows the change, in its pixels.
    noise_dn
        Standard deviation of the noise that was assumed in either photograph.
    median_dn, shown_dn, ratio
        The limit at the median place as it was predicted and as the pair shows it, in levels of a
        follow-up as sharp and as bright as predicted; the second over the first.
    factors
        By what focus, light, registration and texture each raised the limit.
    lost_to
        Sentences on those that explain a loss of more than 15 %, the most first.
    """

    spot_sigma_px: float
    noise_dn: float
    median_dn: float
    shown_dn: float
    ratio: float
    factors: dict[str, float]
    lost_to: tuple[str, ...] = ()


PixelPlane = Literal["scene", "sensor"]
"""Where the size of a pixel is measured."""


class DetectionLimit(StoredValues):
    """What a comparison would have found.

    Parameters
    ----------
    power
        Share of the spots at the limit that are found.
    spots
        Limits, a width each.
    contrast_dn
        Amplitude that was asked about.
    map_spot_sigma_px
        Width of the spots whose limit limit.tif maps.
    pixel_size_mm, pixel_size_on
        Side of a follow-up pixel, if it is known, and where: on the scene or on the sensor.
    predicted
        The limit that was predicted, if it was and for this zoom.
    """

    power: float
    spots: tuple[SpotLimit, ...]
    contrast_dn: float | None = None
    map_spot_sigma_px: float
    pixel_size_mm: float | None = None
    pixel_size_on: PixelPlane | None = None
    predicted: PredictedLimit | None = None

    @property
    def mapped(self) -> SpotLimit:
        """The limit that limit.tif maps."""
        return next(spot for spot in self.spots if spot.spot_sigma_px == self.map_spot_sigma_px)


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
        Variance by which the follow-up is softer than the calibrated PSF predicts, or than the
        reference where there is none, in follow-up pixels, and its standard error, infinite without
        any detail; negative: sharper.
    noise_factor, is_noise_known
        Fitted noise variance over that of the noise model; over 1 DN^2 where none was given.
    registration_err_px, width_err_px2
        Standard deviations of the registration along the gradient, and of the variance by which
        the simulated blur is wrong.
    psf_form
        What the shape of the camera's PSF was known as; None in files of before.
    changes
        What changed, the most significant first.
    false_discovery_rate
        Share of false ones among the changes that was asked for, if it decided the threshold.
    saturated_px
        Follow-up pixels that either photograph shows clipped at white or black.
    kernel
        Where the blur between the photographs is known from; None in files of before.
    detection_limit
        What would have been found; None in files of before.
    frame_px
        Pixels of the follow-up.
    warnings
        Sentences on what makes the changes doubtful.
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
    changes: tuple[Change, ...] = ()
    false_discovery_rate: float | None = None
    saturated_px: int = 0
    kernel: KernelOrigin | None = None
    detection_limit: DetectionLimit | None = None
    frame_px: int | None = None
    warnings: tuple[str, ...] = ()

    def to_dataframe(self) -> "DataFrame":
        """Return the changes as a pandas table, the most significant first.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.

        Examples
        --------
        >>> found.summary.to_dataframe().query("significance > 8")
        """
        return dataframe(change.model_dump() for change in self.changes)


def read_changes(path: Path) -> ChangeSummary:
    """Read a changes.json.

    Raises
    ------
    ResultsFileError
        If it cannot be read, is of another schema, or a value is missing or wrong.
    """
    return read_document(path, ChangeSummary, ResultsFileError, "write it with standoff changes")


def change_table(changes: Sequence[Change]) -> bytes:
    """Return the list of changes as CSV, a line a change."""
    text = StringIO(newline="")
    writer = csv.DictWriter(text, list(Change.model_fields), lineterminator="\n")
    writer.writeheader()
    writer.writerows(change.model_dump() for change in changes)
    return text.getvalue().encode("utf-8")
