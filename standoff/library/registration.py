"""Where a photograph was taken from, and what an operator knows of the pose beforehand."""

import pickle
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from acquisition.photographs import LINEAR, ReadOptions, read_file, read_photograph
from acquisition.printable import on_one_line
from calibration.files import read_homography
from calibration.parallax import Parallax, find_parallax
from calibration.registration import (
    FeatureMatches,
    Homography,
    Registration,
    RegistrationHints,
    RegistrationReference,
    leaving_out,
    parse_points,
    register_images,
)
from simulation.arguments import checked
from simulation.arrays import BoolArray, FloatArray
from simulation.by_value import ByValue
from simulation.notebook import Shown
from standoff.errors import HintError
from standoff.library.call import Call, FilePath, ImageLike, PsfLike, photograph, with_white_level
from standoff.library.psf import camera_psf

_AS_NUMBERS = ReadOptions(encoding=LINEAR)
_MOST_TABLE_BYTES = 16 << 20
"""Twice the four numbers of the most points, written out in full."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HintFiles:
    """Hints at the pose as the caller gives them; at most one of zoom, homography and points.

    ``zoom`` is the approximate ratio of the distances, follow-up over reference. The files hold an
    approximate homography, pairs of points, and a mask of follow-up pixels to leave out.
    """

    zoom: float | None = None
    homography: Path | None = None
    points: Path | None = None
    mask: Path | None = None
    mirrored: bool = False

    @property
    def paths(self) -> tuple[Path | None, ...]:
        """The files, for the provenance."""
        return self.homography, self.points, self.mask


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class AlignmentHints(Shown, ByValue):
    """Hints at a pose, read from their files; `alignment_hints` makes them.

    Their sizes are checked against each pair of photographs.
    """

    files: HintFiles = HintFiles()
    homography: Homography | None = None
    points: FeatureMatches | None = None
    left_out: BoolArray | None = None

    @property
    def settings(self) -> dict[str, float | bool | None]:
        """Which hints are given; the provenance has the hashes of their files."""
        found: dict[str, float | bool | None] = {
            "zoom": self.files.zoom,
            "homography": self.homography is not None,
            "points": self.points is not None,
            "mask": self.left_out is not None,
        }
        # A series that was begun without the option is continued without it.
        return {**found, "mirrored": True} if self.files.mirrored else found

    def of_pair(
        self, reference: tuple[int, int], followup: tuple[int, int], name: str
    ) -> RegistrationHints | None:
        """Return the hints for photographs of these shapes; None if there are none.

        Parameters
        ----------
        reference, followup
            Shapes ``(rows, cols)``.
        name
            Name of the follow-up, for error messages.

        Raises
        ------
        ApplicationError
            If a mask or a homography is for another image size, or a point lies outside its
            photograph.
        """
        rows, cols = followup
        if self.left_out is not None and self.left_out.shape != followup:
            high, wide = self.left_out.shape
            raise HintError(
                f"{_shown(self.files.mask)}: {wide} x {high} px, but {name} has {cols} x {rows}; "
                "a mask has the follow-up's size"
            )
        if self.homography is not None and self.homography.size != (cols, rows):
            wide, high = self.homography.size
            raise HintError(
                f"{_shown(self.files.homography)}: for follow-ups of {wide} x {high} px, but "
                f"{name} has {cols} x {rows}"
            )
        if self.points is not None:
            table = _shown(self.files.points)
            _refuse_points_outside(self.points.followup_px, followup, table, name)
            _refuse_points_outside(self.points.reference_px, reference, table, "the reference")
        zoom, is_mirrored = self.files.zoom, self.files.mirrored
        matrix = None if self.homography is None else self.homography.matrix
        known = (zoom, matrix, self.points, self.left_out, is_mirrored or None)
        if all(one is None for one in known):
            return None
        return RegistrationHints(
            zoom=zoom,
            matrix=matrix,
            points=self.points,
            left_out=self.left_out,
            mirrored=is_mirrored,
        )


def hint_settings(
    hints: AlignmentHints | RegistrationHints | None,
) -> dict[str, float | bool | None]:
    """Return which hints are given; the provenance has the hashes of their files."""
    if isinstance(hints, RegistrationHints):
        digest = sha256(pickle.dumps(hints)).hexdigest()
        return {"given": int(digest[:12], 16)}
    return (hints or AlignmentHints()).settings


def hint_files(hints: AlignmentHints | RegistrationHints | None) -> tuple[Path | None, ...]:
    """The files that hints were read from, for the provenance."""
    return hints.files.paths if isinstance(hints, AlignmentHints) else ()


@checked
def alignment_hints(
    zoom: float | None = None,
    *,
    homography: FilePath | None = None,
    points: FilePath | None = None,
    mask: FilePath | None = None,
    mirrored: bool = False,
) -> AlignmentHints | None:
    """Read hints at a pose; at most one of ``zoom``, ``homography`` and ``points``.

    Parameters
    ----------
    zoom
        Approximate ratio of the distances, follow-up over reference.
    homography
        Path of an H.json with an approximate pose.
    points
        Path of a CSV file with at least four pairs of points.
    mask
        Path of an image of the follow-up's size; pixels that are not 0 are left out.
    mirrored
        Whether one of the photographs shows the scene as in a mirror: the homography found, or
        given, then has a negative determinant.

    Returns
    -------
    AlignmentHints, or None if no hint is given

    Raises
    ------
    HintError, CalibrationError
        If a file cannot be read or does not hold such a hint.

    Examples
    --------
    >>> hints = standoff.alignment_hints(1.2, mask="moving-parts.png")
    >>> summary = standoff.find_changes("before.tif", "after.tif", hints=hints).summary
    >>> len(summary.changes), summary.compared_px < summary.frame_px
    (1, True)
    """
    given = HintFiles(
        zoom=zoom,
        homography=None if homography is None else Path(homography),
        points=None if points is None else Path(points),
        mask=None if mask is None else Path(mask),
        mirrored=mirrored,
    )
    if given == HintFiles():
        return None
    return AlignmentHints(
        files=given,
        homography=None if given.homography is None else read_homography(given.homography),
        points=None if given.points is None else read_points(given.points),
        left_out=None if given.mask is None else read_mask(given.mask),
    )


def read_points(path: Path) -> FeatureMatches:
    """Read pairs of points."""
    name = on_one_line(path)
    try:
        return parse_points(read_file(path, _MOST_TABLE_BYTES).decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise HintError(f"{name}: not a table of text in UTF-8") from error
    except ValueError as error:
        raise HintError(f"{name}: {error}") from error


def read_mask(path: Path) -> BoolArray:
    """Read an image of which every pixel that is not 0 is left out, shape ``(rows, cols)``."""
    stored = np.asarray(read_photograph(path, _AS_NUMBERS).stored)
    left_out = np.asarray(stored != 0 if stored.ndim == 2 else np.any(stored != 0, axis=2))
    if left_out.all():
        raise HintError(
            f"{on_one_line(path)}: leaves out every pixel; a mask is 0 where pixels count"
        )
    return left_out


def _refuse_points_outside(
    points_px: FloatArray, shape: tuple[int, int], name: str, photograph: str
) -> None:
    """Check that points ``(x, y)``, shape (n, 2), lie in a photograph of ``(rows, cols)``."""
    rows, cols = shape
    is_outside = np.any((points_px < -0.5) | (points_px > [cols - 0.5, rows - 0.5]), axis=1)
    if is_outside.any():
        x_px, y_px = points_px[is_outside][0]
        raise HintError(
            f"{name}: the point {x_px:g}, {y_px:g} lies outside {photograph}, which has "
            f"{cols} x {rows} px"
        )


def _shown(path: Path | None) -> str:
    return "" if path is None else on_one_line(path)


@checked
def register(
    reference: ImageLike,
    followup: ImageLike,
    psf: PsfLike | None = None,
    *,
    hints: RegistrationHints | None = None,
    white_level: float | None = None,
    depth: bool = False,
    reading: ReadOptions | None = None,
) -> Registration:
    """Return the pose of a follow-up relative to its reference.

    Parameters
    ----------
    reference, followup
        Arrays or files; either may be the nearer one.
    psf
        The camera's PSF; without it, a width (sigma) of 0.65 px is assumed.
    hints
        What is known of the pose beforehand: the ratio of the distances, an approximate homography
        or pairs of points, and follow-up pixels to leave out.
    white_level
        Level, as it is stored, at which both are clipped; pixels at that level do not count.
        Plateaus and pixels that an array masks never count.
    depth
        Whether parallax of a scene with depth is looked for, too, which takes a few seconds; by
        default the scene is taken as a plane.
    reading
        How the two are read; see ``standoff.reading``.

    Returns
    -------
    Registration
        ``matrix`` maps follow-up pixels ``(x, y, 1)`` to reference pixels; ``warnings`` are
        sentences on what to check. ``parallax`` holds how each pixel of a scene with depth is
        displaced beside the plane, if that was asked for.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    RegistrationError
        If the two cannot be aligned; ``reason`` and ``at_fault`` say why.

    Examples
    --------
    >>> pose = standoff.register("before.tif", "after.tif", "psf.json")
    >>> round(pose.zoom, 3)
    1.188
    """
    options = with_white_level(reading, white_level)
    near, far = (
        photograph(reference, "reference", options),
        photograph(followup, "followup", options),
    )
    known = None if psf is None else camera_psf(Call("register"), psf).gaussian
    is_stated = options.white_level is not None
    images = near.filled.grey_dn, far.filled.grey_dn
    found = register_images(
        RegistrationReference.of(images[0], near.not_measured(is_clipped=is_stated)),
        images[1],
        known,
        leaving_out(hints, far.not_measured(is_clipped=is_stated)),
    )
    parallax = find_parallax(*images, found.pose) if depth else None
    if parallax is None or not np.isfinite(parallax.parallax_px).any():
        return found
    said = _depth_sentence(parallax)
    return replace(found, parallax=parallax, warnings=(*found.warnings, said))


def _depth_sentence(parallax: Parallax) -> str:
    """Say how deep a scene is, in pixels of its coarser photograph."""
    low, high = np.nanpercentile(parallax.parallax_px, [2.5, 97.5])
    return (
        f"the scene has depth: 95 % of what both photographs show is displaced by {low:+.1f} to "
        f"{high:+.1f} px relative to a plane; that explains "
        f"{100 * parallax.held_out_gain:.0f} % of what the plane leaves unexplained, and "
        "parallax.pose follows it"
    )
