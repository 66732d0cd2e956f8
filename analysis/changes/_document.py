"""The document changes.json: what a comparison of two photographs found, and sentences on it."""

import csv
from collections.abc import Sequence
from io import StringIO
from math import hypot, inf, isfinite, sqrt
from typing import TYPE_CHECKING, Final, Literal

from pydantic import Field

from acquisition.dataframe import dataframe
from analysis.detection_limits import (
    DetectionLimit,
    percent_text,
    prediction_sentence,
    spot_sentence,
)
from analysis.errors import ResultsFileError
from analysis.results_file import InfiniteAsNull, ResultsDocument, StoredValues
from calibration.documents import read_document
from calibration.estimate import NORMAL_95, signed_with_reach
from simulation.arguments import FilePath, checked
from simulation.choices import PsfForm

if TYPE_CHECKING:
    from pandas import DataFrame


_CHANGES_SCHEMA: Final = "standoff.changes/1"

KernelOrigin = Literal["calibrated", "pair", "both"]
"""Where the blur between two photographs is known from: psf.json, themselves, or both."""

Happened = Literal["gone", "new", "brighter", "darker", "colour", "moved"]
"""What happened to a thing: gone and new only where one photograph shows what surrounds it."""

_Row3 = tuple[float, float, float]


class Change(StoredValues):
    """One thing that changed or moved: connected changes that touch, or lie in one outline.

    Its place is its middle: the centre of a spot, or of the outline of anything else.

    Parameters
    ----------
    x_px, y_px, reference_x_px, reference_y_px
        Its place in the follow-up and in the reference; 0 at the centre of the first pixel.
    area_px
        Its area in follow-up pixels, whatever its amplitude: the area within the contour at half of
        the difference inside; of a spot ``2 pi sigma^2``, the area of a flat spot with the same
        peak and the same sum.
    amplitude_dn, amplitude_err_dn
        Peak of the change, after minus before, in the follow-up's levels, as the coarser of the two
        photographs shows it, and its standard error.
    significance
        Standard deviations by which its strongest place stands out from chance; positive.
    q_value
        Share of false changes expected among those that are at least as significant.
    spot_sigma_px
        Width (sigma) of the Gaussian spot that fits best, in follow-up pixels; None in older files.
    displacement_px, displacement_err_px
        Shift ``(x, y)`` in follow-up pixels, from before to after, that explains it better than an
        added signal, and its standard errors; None if no shift does.
    is_moved
        Whether a shift explains it better; ``area_px`` is then that of all the connected changes
        that the shift explains.
    what
        What happened to it; None in older files.
    amplitude_rgb_dn
        The same peak in red, green and blue; None for photographs without colours. ``amplitude_dn``
        is its luma, which is near 0 if only the colour changed.
    delta_e
        CIEDE2000 difference of its mean colours before and after; None without colours, or if a
        file does not state its white.
    parts
        If it consists of several connected changes of one sign, these, the most significant first;
        for a movement, the changes that it leaves unexplained.
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
    displacement_px: tuple[float, float] | None = None
    displacement_err_px: tuple[float, float] | None = None
    is_moved: bool = False
    what: Happened | None = None
    amplitude_rgb_dn: tuple[float, float, float] | None = None
    delta_e: float | None = None
    parts: tuple["Change", ...] = ()


class SceneHeights(StoredValues):
    """Heights of a scene above the plane of the pose, by a camera of known geometry.

    Parameters
    ----------
    low_mm, median_mm, high_mm
        Heights that 1, 50 and 99 % of the pixels do not exceed, positive towards the camera.
    err_mm
        Median of the standard error.
    distance_mm, baseline_mm
        Distance of the follow-up's camera from the plane, and of the two cameras from one another.
    """

    low_mm: float
    median_mm: float
    high_mm: float
    err_mm: float
    distance_mm: float
    baseline_mm: float


class SceneParallax(StoredValues):
    """Depth of a scene, as the comparison followed it: parallax beside the plane of the pose.

    Parameters
    ----------
    low_px, median_px, high_px
        Parallax in follow-up pixels that 1, 50 and 99 % of the pixels do not exceed, towards the
        epipole.
    err_px
        Median of its standard error where it was measured.
    epipole
        Where the reference's camera stood as the follow-up sees it, homogeneous ``(x, y, w)`` of
        length 1: at ``x / w``, ``y / w`` in px.
    features, agreeing
        Features and places of optical flow that match, and those within a pixel of their epipolar
        lines.
    hidden_px
        Follow-up pixels within both frames that are hidden in one of the photographs, lie at a
        step, or have no known depth: they were not compared.
    held_out_gain
        Share of what a plane leaves unexplained that parallax explains, in blocks that were not
        looked at when it was measured.
    larger_is
        Whether what has the larger parallax is nearer to the camera or farther away; None if the
        two photographs do not tell.
    heights
        The same in mm; None without the geometry of the camera.
    """

    low_px: float
    median_px: float
    high_px: float
    err_px: float
    epipole: tuple[float, float, float]
    features: int
    agreeing: int
    hidden_px: int
    held_out_gain: float
    larger_is: Literal["nearer", "farther"] | None = None
    heights: SceneHeights | None = None


class ChangeSummary(ResultsDocument):
    """Figures of a comparison of two photographs.

    Parameters
    ----------
    reference, followup
        Names of the photographs.
    homography, distortion_k1, distortion_k1_err, zoom
        Matrix that maps follow-up pixel centres to reference pixel centres, both without
        distortion; distortion of the lens, with its standard error if it was fitted; reference
        pixels per follow-up pixel at the follow-up's centre.
    changed_px, compared_px
        Number of pixels that changed, and of pixels that were compared.
    threshold_sd, false_alarms_px
        Standard deviations beyond which a pixel counts as changed, and the expected number of
        pixels per frame that exceed them by chance.
    gain, gain_err
        Mean of the fitted ratio of the light, follow-up over reference, and its standard error,
        which is infinite in older files.
    extra_blur_px2, extra_blur_err_px2
        Variance in follow-up px² by which the follow-up is softer (negative: sharper) than the
        calibrated PSF predicts, or, without a PSF, than the reference; and its standard error,
        which is infinite if there is no detail.
    noise_factor, is_noise_known
        Fitted noise variance relative to that of the noise model, or in DN^2 if no noise model was
        given; and whether one was given.
    registration_err_px, width_err_px2
        Standard deviation of the registration along the gradient, and of the error in the variance
        of the simulated blur.
    psf_form
        Form in which the camera's PSF was known; None in older files.
    changes
        The changes, the most conspicuous first: by contrast and the square root of the area.
    moved, moved_px
        The movements: what a shift explains, in the same order, and the number of its pixels; empty
        if movements were counted among the changes.
    least_dn, below_least
        Amplitude below which changes are not listed, None if it was not asked for: the step of the
        files' levels at each place then decides; and the number of changes below it.
    false_discovery_rate
        Share of false changes that was asked for, if it set the threshold.
    saturated_px
        Number of follow-up pixels at which either photograph is clipped, at white or black.
    kernel
        What the blur between the photographs was derived from; None in older files.
    detection_limit
        The least amplitudes that would have been found; None in older files.
    frame_px
        Number of pixels of the follow-up.
    parallax
        Parallax of a scene with depth; None where a plane explains the pair.
    warnings
        Sentences on what makes the changes doubtful.
    """

    schema_name: Literal["standoff.changes/1"] = Field(default=_CHANGES_SCHEMA, alias="schema")
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
    gain_err: InfiniteAsNull = inf
    extra_blur_px2: float
    extra_blur_err_px2: InfiniteAsNull
    noise_factor: float
    is_noise_known: bool
    registration_err_px: float
    width_err_px2: float
    psf_form: PsfForm | None = None
    changes: tuple[Change, ...] = ()
    moved: tuple[Change, ...] = ()
    moved_px: int = 0
    least_dn: float | None = None
    below_least: int = 0
    false_discovery_rate: float | None = None
    saturated_px: int = 0
    kernel: KernelOrigin | None = None
    detection_limit: DetectionLimit | None = None
    frame_px: int | None = None
    parallax: SceneParallax | None = None
    warnings: tuple[str, ...] = ()

    def to_dataframe(self) -> "DataFrame":
        """Return the changes as a pandas table, one row per change, in the order of ``changes``.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.

        Examples
        --------
        >>> found = standoff.find_changes("before.tif", "after.tif", "psf.json")
        >>> len(found.summary.to_dataframe().query("significance > 8"))
        1
        """
        return dataframe(change.model_dump() for change in self.changes)


@checked
def read_changes(path: FilePath) -> ChangeSummary:
    """Read a changes.json.

    Parameters
    ----------
    path
        Path of the file, as the result of ``find_changes`` or ``standoff changes`` writes it.

    Returns
    -------
    ChangeSummary
        The changes and the figures of the comparison, without the images.

    Raises
    ------
    ResultsFileError
        If it cannot be read, is of another schema, or a value is missing or wrong.

    Examples
    --------
    >>> found = standoff.find_changes("before.tif", "after.tif", "psf.json")
    >>> found.write("compared")
    >>> standoff.read_changes("compared/changes.json") == found.summary
    True
    """
    return read_document(path, ChangeSummary, ResultsFileError, "write it with standoff changes")


_PARTS = {
    "displacement_px": ("displacement_x_px", "displacement_y_px"),
    "displacement_err_px": ("displacement_x_err_px", "displacement_y_err_px"),
    "amplitude_rgb_dn": ("amplitude_red_dn", "amplitude_green_dn", "amplitude_blue_dn"),
}
"""Columns of the pairs and triples of numbers of a change."""


def _flat(change: Change) -> dict[str, float | bool | None]:
    values = change.model_dump(exclude={"parts"})
    for name, columns in _PARTS.items():
        values |= dict(zip(columns, values.pop(name) or (None,) * len(columns), strict=True))
    return values


def change_table(changes: Sequence[Change]) -> bytes:
    """Return the list of changes as CSV, one row per change."""
    text = StringIO(newline="")
    columns = [
        column
        for name in Change.model_fields
        if name != "parts"
        for column in _PARTS.get(name, (name,))
    ]
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(map(_flat, changes))
    return text.getvalue().encode("utf-8")


_SURE = 3.0
"""Standard errors by which the blur must differ from none, to be said: of equal photographs, once
in 400 pairs."""


def describe_focus(found: ChangeSummary) -> str | None:
    """Say how far the follow-up's blur is from what was expected; None if nothing is known.

    With a calibration, what was expected is its blur at the follow-up's distance; without one, the
    reference's own.
    """
    value_px2, err_px2 = found.extra_blur_px2, found.extra_blur_err_px2
    if not isfinite(err_px2):
        return None
    figures = f"{signed_with_reach(value_px2, NORMAL_95 * err_px2)} px^2"
    if found.kernel == "pair" and abs(value_px2) <= _SURE * err_px2:
        return f"the follow-up is as sharp as the reference ({figures})"
    word = "softer" if value_px2 > 0 else "sharper"
    errors = f", {abs(value_px2) / err_px2:.0f} standard errors" if err_px2 > 0 else ""
    spread = f"{word} by a Gaussian of {sqrt(abs(value_px2)):.2f} px ({figures}{errors})"
    if found.kernel == "both":
        return f"the focus has changed: against psf.json and the pose, the follow-up is {spread}"
    if found.kernel == "pair":
        return f"against the reference, the follow-up is {spread}"
    return f"no change of focus: the blur is what psf.json and the pose explain ({figures})"


def describe_limit(found: ChangeSummary) -> str | None:
    """Say which spots would have been found; None for older files."""
    if found.detection_limit is None:
        return None
    sentence = spot_sentence(found.detection_limit)
    if found.frame_px:
        left_out = 1 - found.compared_px / found.frame_px
        sentence += f"; {percent_text(left_out)} were not compared"
    return sentence


def describe_prediction(found: ChangeSummary) -> str | None:
    """Say how the limit and the predicted one compare; None where nothing was predicted."""
    limit = found.detection_limit
    if limit is None or limit.predicted is None:
        return None
    return prediction_sentence(limit.predicted)


def describe_moved(found: ChangeSummary) -> str | None:
    """Say how many changes a shift explains; None if it explains none."""
    moved = found.moved
    if not moved:
        return None
    furthest = max(map(_distance_px, moved))
    what = "1 change is" if len(moved) == 1 else f"{len(moved)} changes are"
    how_far = "by" if len(moved) == 1 else "by up to"
    return (
        f"{what} listed separately: what was there before is elsewhere now, {how_far} "
        f"{furthest:.1f} px ({found.moved_px} pixels)"
    )


def describe_depth(found: ChangeSummary) -> str | None:
    """Say how deep the scene is, and what that hides; None where a plane explains the pair."""
    depth = found.parallax
    if depth is None:
        return None
    hidden = ""
    if found.frame_px:
        share = percent_text(depth.hidden_px / found.frame_px)
        hidden = (
            f"; {share} of the follow-up is hidden in one of the two photographs, lies beside a "
            "step in depth, or is of unknown depth"
        )
    side = "" if depth.larger_is is None else f" (the larger, the {depth.larger_is})"
    heights = ""
    if depth.heights is not None:
        heights = (
            f"; it reaches from {depth.heights.low_mm:+.3g} to {depth.heights.high_mm:+.3g} mm "
            f"above the plane, at a distance of {depth.heights.distance_mm:.4g} mm"
        )
    return (
        f"the scene has depth: parallax of {depth.low_px:+.1f} to {depth.high_px:+.1f} px{side} "
        f"relative to a plane explains {100 * depth.held_out_gain:.0f} % of what the plane leaves "
        f"unexplained{hidden}{heights}"
    )


def _distance_px(change: Change) -> float:
    return 0.0 if change.displacement_px is None else hypot(*change.displacement_px)


def describe_least(found: ChangeSummary) -> str | None:
    """Say how many changes are too small to be listed; None if none is."""
    count = found.below_least
    if not count:
        return None
    what = "the step of the files' levels" if found.least_dn is None else f"{found.least_dn:g} DN"
    verb = "1 significant difference is" if count == 1 else f"{count} significant differences are"
    return f"{verb} smaller than {what} and not listed"
