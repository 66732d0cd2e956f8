"""Finds what changed between two photograph files, and writes a list and maps of the changes."""

from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, TypedDict, cast

import numpy as np

from acquisition.files import PAGES, make_folder, write_file, write_page, written_together
from acquisition.photographs import (
    FileSteps,
    Photograph,
    ReadOptions,
    luma_plane,
    write_float_tiff,
    write_mask,
)
from analysis.changes import (
    ChangeCriteria,
    ChangeOptions,
    ChangeResult,
    CodedAlike,
    DepthMap,
    PairColours,
    change_table,
    changes_between,
    depth_in_mm,
)
from analysis.choices import FALSE_ALARMS
from analysis.errors import AnalysisError
from analysis.reports import (
    ColourPair,
    changes_report,
    compared_pictures,
    depth_figure,
    limit_figure,
    moment_text,
    plot_changes,
    view_figures,
    write_figure,
)
from analysis.results_file import write_results
from calibration.documents import json_object
from calibration.errors import CalibrationError
from calibration.registration import RegistrationHints, leaving_out
from simulation import Psf, PsfField
from simulation.arguments import checked
from simulation.arrays import BoolArray, Float32Array, FloatArray
from simulation.choices import PsfShape
from standoff.errors import ApplicationError
from standoff.library.call import (
    Call,
    FilePath,
    ImageLike,
    NoiseLike,
    Progress,
    PsfLike,
    camera_noise,
    output_path,
    path_of,
)
from standoff.library.limit_options import (
    DetectionLimitOptions,
    SceneScale,
    expected_limit,
    limit_files,
    limit_rgb,
    note_on_prediction,
    scene_scale,
)
from standoff.library.psf import frame_psf
from standoff.library.registration import AlignmentHints, hint_files

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

DEPTH_FILES = ("parallax.tif", "parallax-error.tif", "depth.tif", "depth-error.tif")
"""Those that only comparisons of scenes with depth write; the last two only with a geometry."""

CHANGE_FILES = (
    "difference.tif",
    "plain-difference.tif",
    "pose-difference.tif",
    "uncertainty.tif",
    "significance.tif",
    "limit.tif",
    *DEPTH_FILES,
    "changes.png",
    "compared.png",
    "changes-figure.png",
    "changes.csv",
    "report.html",
    "changes.json",
)
"""Files that a comparison writes; the last one last."""

_DRAWING = Lock()
"""Matplotlib's style is one for all threads, of which a Dask worker may have several."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ComparisonRules:
    """How two photographs are compared, here or by a worker.

    ``options`` hold the noise and the number of false alarms, ``hints`` the pose and the masks.
    ``white_level`` is the level at which the files are clipped; None takes the files' own.
    ``scale`` holds the size of a pixel.
    """

    options: ChangeOptions = field(default_factory=ChangeOptions)
    hints: AlignmentHints | RegistrationHints | None = None
    white_level: float | None = None
    scale: SceneScale = field(default_factory=SceneScale)

    @property
    def left_out(self) -> BoolArray | None:
        """Follow-up pixels that do not count."""
        return None if self.hints is None else self.hints.left_out


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ComparedPhotographs(ChangeResult):
    """Two photographs and what changed between them; ``left_out`` masks the pixels left out.

    ``depth`` has distances and heights in mm of a scene with depth; None without a geometry.
    """

    reference: Photograph
    followup: Photograph
    left_out: BoolArray | None = None
    depth: DepthMap | None = None
    notes: tuple[str, ...] = ()

    @property
    def colours(self) -> ColourPair | None:
        """Both photographs in colour; None if one of them is grey."""
        if not (self.reference.is_colour and self.followup.is_colour):
            return None
        return ColourPair(
            reference_dn=self.reference.colour_planes, followup_dn=self.followup.colour_planes
        )

    @property
    def depth_maps(self) -> dict[str, Float32Array]:
        """Maps of a scene with depth, by the names of their files."""
        maps: list[Float32Array] = []
        if self.parallax is not None:
            maps = [self.parallax.parallax_px, self.parallax.error_px]
        if self.depth is not None:
            maps += [self.depth.depth_mm, self.depth.error_mm]
        return dict(zip(DEPTH_FILES, maps, strict=False))

    def to_dataframe(self) -> "DataFrame":
        """Return the changes as a pandas table; see `ChangeSummary`."""
        return self.summary.to_dataframe()

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of the follow-up with its changes, both differences and significance."""
        followup = self.followup
        return plot_changes(self, followup.colour_planes if followup.is_colour else None, ax)

    def to_json(self) -> dict[str, Any]:
        """Return the summary as ``standoff changes --json`` prints it, without the folder."""
        return json_object(self.summary)

    def page(self) -> str:
        """Return the report as one HTML document."""
        rows, cols = self.valid.shape
        pictures = compared_pictures(self.reference.grey_dn, self, self.left_out, self.colours)
        return changes_report(
            self.summary,
            view_figures(pictures, self.summary.changes, (cols, rows), self.summary.moved),
            limit_figure(self),
            tuple(
                (
                    f"{when}, taken",
                    moment_text(photograph.facts.taken) if photograph.facts.taken else "not stated",
                )
                for when, photograph in (("before", self.reference), ("after", self.followup))
            ),
            depth_figure(self, None if self.depth is None else self.depth.height_mm),
        ).html()

    def write_report(self, path: FilePath) -> None:
        """Write the report, HTML or PDF.

        Raises
        ------
        ApplicationError
            If the file cannot be written.
        """
        write_page(output_path(path, "path", PAGES), self.page())

    def write(self, folder: FilePath) -> None:
        """Write maps, figure, list, report page and changes.json into a folder, all or none.

        Raises
        ------
        ApplicationError, ResultsFileError
            If a file cannot be written.
        """
        out = make_folder(path_of(folder, "folder"))
        with written_together(out / "changes.json") as part:
            write_changes(part, self)
            # Those of an earlier result.
            for name in set(DEPTH_FILES) - set(self.depth_maps):
                (out / name).unlink(missing_ok=True)


class ComparisonKeywords(TypedDict, total=False):
    """How photographs are compared: the keywords of `find_changes`."""

    transfer: PsfShape
    noise: NoiseLike | None
    false_alarms: float
    false_discovery_rate: float | None
    hints: AlignmentHints | RegistrationHints | None
    white_level: float | None
    limit: DetectionLimitOptions | None
    count_moved: bool
    flat: bool
    least: float | None
    reading: ReadOptions | None
    progress: Progress | None


@checked
def find_changes(
    reference: ImageLike,
    followup: ImageLike,
    psf: PsfLike | None = None,
    *,
    transfer: PsfShape = "best",
    noise: NoiseLike | None = None,
    false_alarms: float = FALSE_ALARMS,
    false_discovery_rate: float | None = None,
    hints: AlignmentHints | RegistrationHints | None = None,
    white_level: float | None = None,
    limit: DetectionLimitOptions | None = None,
    count_moved: bool = False,
    flat: bool = False,
    least: float | None = None,
    reading: ReadOptions | None = None,
    progress: Progress | None = None,
) -> ComparedPhotographs:
    """Find the changes between two photographs that pose, blur and light do not explain.

    Parameters
    ----------
    reference, followup
        Arrays or files; the follow-up is the later photograph, from nearer or further away.
    psf
        The camera's PSF; without it, the blur between the photographs is fitted to them.
    transfer
        Which PSF of a calibration to use: ``measured``, ``gaussian``, or ``best``: the measured
        one if the calibration has it, else the Gaussian.
    noise
        Noise of both photographs, or the path of a noise.json; without it, the noise is fitted.
    false_alarms
        Expected number of pixels per frame that are flagged by chance.
    false_discovery_rate
        Expected share of false changes among those listed; if given, it sets the threshold instead
        of ``false_alarms``.
    hints
        What is known of the pose beforehand: `RegistrationHints`, or the result of
        `alignment_hints`. Pixels that the hints leave out are not compared either.
    white_level
        Level, as it is stored, at which the files are clipped; by default the files' own.
    limit
        Spots for which the detection limit is mapped, size of a pixel in mm or geometry of the
        camera, and curves that predict a limit.
    count_moved
        Whether what a shift of a few pixels explains is listed among the changes; by default it
        is listed apart, in ``summary.moved``.
    flat
        Whether the scene is taken as a plane; by default parallax of a scene with depth is followed
        where that explains more of parts that were held out.
    least
        Amplitude in DN below which significant changes are counted but not listed; by default the
        step of the files' levels.
    reading
        How files are read; see ``standoff.reading``.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    ComparedPhotographs
        ``summary.changes`` is the list of changes; the maps are on the follow-up's pixels;
        ``write`` writes list, maps and report into a folder.

    Raises
    ------
    TypeError
        If an argument has the wrong type.
    ApplicationError
        If a photograph cannot be read, or a hint does not fit the photographs.
    AnalysisError, CalibrationError
        If the photographs overlap too little or cannot be aligned; the message names the
        follow-up.

    Examples
    --------
    >>> found = standoff.find_changes("before.tif", "after.tif", "psf.json")
    >>> [(round(one.x_px), round(one.y_px)) for one in found.summary.changes]
    [(200, 90)]
    """
    how = ComparisonKeywords(
        transfer=transfer,
        noise=noise,
        false_alarms=false_alarms,
        false_discovery_rate=false_discovery_rate,
        hints=hints,
        white_level=white_level,
        limit=limit,
        count_moved=count_moved,
        flat=flat,
        least=least,
        reading=reading,
        progress=progress,
    )
    call, rules = begun_comparison("find_changes", psf, how)
    near = call.photograph(reference, "reference")
    far = call.photograph(followup, "followup")
    known = None
    if psf is not None:
        rows, cols = far.stored.shape[:2]
        frame = (cols, rows) if near.stored.shape[:2] == (rows, cols) else None
        known = frame_psf(call, psf, frame, "matched", transfer)
    found = compared(near, far, known, rules)
    for warning in found.summary.warnings:
        call.announce(warning)
    note_on_prediction(call, limit, found.summary)
    summary = found.summary.model_copy(
        update={
            "reference": near.name,
            "followup": far.name,
            "provenance": call.provenance(),
        }
    )
    return replace(found, summary=summary, notes=call.notes)


def begun_comparison(
    function: str, psf: PsfLike | None, how: ComparisonKeywords
) -> tuple[Call, ComparisonRules]:
    """Begin a call of a public function; return it, and how photographs are compared."""
    limit, hints, noise = how.get("limit"), how.get("hints"), how.get("noise")
    files = psf, noise, *limit_files(limit), *hint_files(hints)
    call = Call(function, how.get("progress"), how.get("reading"), files)
    asked = limit or DetectionLimitOptions()
    criteria = {one.name for one in fields(ChangeCriteria)}
    options = ChangeOptions(
        **{name: value for name, value in cast("dict[str, Any]", how).items() if name in criteria},
        least_dn=how.get("least"),
        noise=camera_noise(noise),
        spot_sigma_px=asked.spot_sigma_px,
        limit_contrast_dn=asked.contrast_dn,
        expected=expected_limit(asked),
        limit_rgb=limit_rgb(asked.colour),
    )
    return call, ComparisonRules(
        options=options,
        hints=hints,
        white_level=how.get("white_level"),
        scale=scene_scale(call, asked, psf),
    )


def compared(
    near: Photograph, far: Photograph, psf: Psf | PsfField | None, rules: ComparisonRules
) -> ComparedPhotographs:
    """Align and compare two photographs; errors name the follow-up."""
    stated, hints = rules.white_level, rules.hints
    if isinstance(hints, AlignmentHints):
        hints = hints.of_pair(near.stored.shape[:2], far.stored.shape[:2], far.name)
    masks = near.masked, far.masked
    hints = leaving_out(hints, masks[1])
    near, far, said = _decoded_alike(near.filled, far.filled)
    before, after = near.file_steps, far.file_steps
    colours = _colours(near, far, (before, after))
    options = replace(
        rules.options,
        hints=hints,
        left_out=rules.left_out if masks[1] is None or hints is None else hints.left_out,
        reference_left_out=masks[0],
        white_level_dn=(near.white_level_dn(stated), far.white_level_dn(stated)),
        variance_dn2=(_variance_dn2(near), _variance_dn2(far)),
        step_variance_dn2=(before.variance_dn2, after.variance_dn2),
        step_dn=(before.step_dn, after.step_dn),
        coded_steps=tuple(one.coded for one in (before, after) if one.coded is not None),
        coded_alike=lambda: _coded_alike(near, far, colours),
        colours=colours,
    )
    try:
        found = changes_between(near.grey_dn, far.grey_dn, psf, options)
    except CalibrationError as error:
        raise CalibrationError(f"{far.path}: {error}") from error
    except AnalysisError as error:
        raise AnalysisError(f"{far.path}: {error}") from error
    summary = found.summary
    update: dict[str, object] = {"warnings": (*summary.warnings, *said)}
    if summary.detection_limit is not None:
        update["detection_limit"] = rules.scale.in_mm(summary.detection_limit, summary.zoom)
    found = replace(found, summary=summary.model_copy(update=update))
    found, depth = _in_mm(found, rules.scale)
    own = {one.name: getattr(found, one.name) for one in fields(found)}
    return ComparedPhotographs(
        **own, reference=near, followup=far, left_out=options.left_out, depth=depth
    )


def _in_mm(found: ChangeResult, scale: SceneScale) -> tuple[ChangeResult, DepthMap | None]:
    """Depth of a scene in mm, by the geometry of the camera, if that is given."""
    figures, placed, pose = found.summary.parallax, scale.placed, found.pose
    if found.parallax is None or figures is None or placed is None:
        return found, None
    missing = "the pose does not determine where the two cameras stood"
    depth = None
    try:
        camera = placed.camera((pose.reference_shape, pose.followup_shape))
        depth = depth_in_mm(pose, (found.parallax, figures), camera, placed.reference_mm)
    except ApplicationError as error:
        missing = str(error)
    if depth is None:
        update: dict[str, object] = {
            "warnings": (*found.summary.warnings, f"no depth in mm: {missing}")
        }
    else:
        update = {"parallax": depth.figures}
    return replace(found, summary=found.summary.model_copy(update=update)), depth


def _colours(
    near: Photograph,
    far: Photograph,
    steps: tuple[FileSteps, FileSteps],
    *,
    are_coded_alike: bool = False,
) -> PairColours | None:
    """Colours of both, with the steps of their channels; None if one of them is grey.

    Where a JPEG has half the pixels for them, the other gets as few, and what each loses counts
    among its steps; not where pixels lie upon each other and lose alike.
    """
    if not (near.is_colour and far.is_colour):
        return None
    before, after = steps
    variance = before.channel_variance_dn2, after.channel_variance_dn2
    if not are_coded_alike:
        near, far = near.with_colours_halved_as(far), far.with_colours_halved_as(near)
        lost = near.halved_colours_variance_dn2, far.halved_colours_variance_dn2
        variance = _together(variance[0], lost[0]), _together(variance[1], lost[1])
    return PairColours(
        reference_dn=near.colour_planes,
        followup_dn=far.colour_planes,
        step_variance_dn2=variance,
        step_dn=(before.channel_step_dn, after.channel_step_dn),
        step_correlation=_step_correlation(before, after),
        white_dn=(near.full_scale_dn, far.full_scale_dn),
    )


def _step_correlation(before: FileSteps, after: FileSteps) -> FloatArray:
    """Correlation of the channels' errors by the steps of both files; none if it is not known."""
    known = [
        one.channel_covariance for one in (before, after) if one.channel_covariance is not None
    ]
    if not known:
        return np.eye(3)
    covariance = np.sum(known, axis=0)
    sds = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / sds / sds[:, np.newaxis])


def _together(one: Float32Array | None, other: Float32Array | None) -> Float32Array | None:
    """The sum of two variances, of which either may not be known."""
    return other if one is None else one if other is None else one + other


def _coded_alike(near: Photograph, far: Photograph, colours: PairColours | None) -> CodedAlike:
    """Levels of both as files that are coded alike hold them, if that makes them more alike.

    A file that was made of the other one is not to be coded a second time: most of its levels are
    the other's to less than what coding changes.
    """
    given = near.grey_dn, far.grey_dn
    if colours is not None:
        colours = _colours(near, far, (near.file_steps, far.file_steps), are_coded_alike=True)
    as_given = CodedAlike(photographs=given, colours=colours)
    recoded = near.coded_as(far), far.coded_as(near)
    if recoded[0] is near and recoded[1] is far:
        return as_given
    alike = recoded[0].grey_dn, recoded[1].grey_dn
    apart, still_apart = (float(np.mean(np.abs(one - other))) for one, other in (given, alike))
    coding = max(_typical_difference(*each) for each in zip(given, alike, strict=True))
    if not (still_apart < apart or _typical_difference(*given) > coding):
        return as_given
    steps = recoded[0].file_steps, recoded[1].file_steps
    return CodedAlike(photographs=alike, colours=_colours(*recoded, steps, are_coded_alike=True))


def _typical_difference(one: FloatArray, other: FloatArray) -> float:
    """Median of the absolute difference, which no change of a part of the frame moves."""
    return float(np.median(np.abs(one - other)))


def _variance_dn2(photograph: Photograph) -> Float32Array | None:
    """Variance of each level of a bracket; a sample of a few frames is too rough to judge one."""
    variance = photograph.grey_variance_dn2
    if variance is None or not photograph.has_modelled_variance:
        return None
    return (variance / photograph.frames).astype(np.float32)


def write_changes(out: Path, found: ComparedPhotographs) -> None:
    """Write maps, figure, list, report page and changes.json into the folder ``out``."""
    error_dn = np.where(found.valid, np.sqrt(found.variance_dn2), 0.0)
    for kind, image in (
        ("difference", found.difference_dn),
        ("plain-difference", found.plain_difference_dn),
        ("pose-difference", found.pose_difference_dn),
        ("uncertainty", error_dn),
        ("significance", found.significance),
        ("limit", found.limit_dn),
    ):
        description = f"standoff changes: {kind} of {found.followup.path.name}"
        write_float_tiff(out / f"{kind}.tif", image.astype(np.float32), description)
    for name, image in found.depth_maps.items():
        kind = Path(name).stem.replace("-", " ")
        description = f"standoff changes: {kind} of {found.followup.path.name}"
        write_float_tiff(out / name, image, description)
    write_mask(out / "changes.png", found.is_change)
    write_mask(out / "compared.png", found.valid)
    with _DRAWING:
        write_figure(out / "changes-figure.png", found.plot())
    write_file(out / "changes.csv", change_table((*found.summary.changes, *found.summary.moved)))
    write_file(out / "report.html", found.page().encode("utf-8"))
    write_results(out / "changes.json", found.summary)


_AS_MUCH_NEARER = 4.0
"""How much nearer than the decoded levels the stored ones of a copy are. Of nine of scikit-image's
pictures, each beside another one, they are 2.5 times as near at most."""


def _decoded_alike(
    near: Photograph, far: Photograph
) -> tuple[Photograph, Photograph, tuple[str, ...]]:
    """Take a photograph that says no encoding as the other one, if it is a copy of that one.

    A TIFF of 8 bits is linear where nothing is said, a PNG is sRGB: of one picture saved as both
    the light would differ at every level. Returned with a sentence where an encoding was taken
    over.
    """
    if near.encoding.name == far.encoding.name or near.stored.shape[:2] != far.stored.shape[:2]:
        return near, far, ()
    if near.is_encoding_stated and far.is_encoding_stated:
        return near, far, ()
    if near.pattern is not None or far.pattern is not None:
        return near, far, ()
    stored, decoded = (
        float(np.sqrt(np.mean(np.square(one - other))))
        for one, other in ((_stored(near), _stored(far)), (_decoded(near), _decoded(far)))
    )
    if not stored * _AS_MUCH_NEARER < decoded:
        return near, far, ()
    # Of two that say nothing, the one whose kind of file is usually of a picture for the screen.
    is_near = far.is_encoding_stated or (near.encoding.is_linear and not near.is_encoding_stated)
    copy, other = (near, far) if is_near else (far, near)
    if len(other.encoding.curves) > 1 and not copy.is_colour:
        return near, far, ()
    said = (
        f"{copy.name} does not state how its levels are encoded, and its levels match those of "
        f"{other.name}: read as {other.encoding.name}, like that file"
    )
    taken = copy.taken_as(other.encoding, f"as {other.name}")
    return (taken, far, (said,)) if is_near else (near, taken, (said,))


def _stored(photograph: Photograph) -> FloatArray:
    return np.asarray(luma_plane(photograph.stored) / photograph.white_dn)


def _decoded(photograph: Photograph) -> FloatArray:
    return np.asarray(photograph.grey_dn / photograph.white_dn)
