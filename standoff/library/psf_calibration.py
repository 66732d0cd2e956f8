"""Calibrates a camera's PSF: from edges, from the edges of a scene, or from two distances."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Literal

from acquisition.bench import LabelsConfig, OpticsConfig, load_bench
from acquisition.files import PAGES, write_page
from acquisition.photographs import ReadOptions
from acquisition.printable import on_one_line
from acquisition.session import Session
from analysis.reports import psf_remarks
from calibration.choices import CalibrationMethod, Channel, Pattern, TargetChoice
from calibration.edges import EdgeImage, EdgeSelection, Region
from calibration.errors import CalibrationError
from calibration.files import read_correction
from calibration.noise import CorrectionMaps, level_noise
from calibration.psf import (
    PsfCalibration,
    PsfOrigin,
    calibrate_mosaic,
    capture_images,
    origin_of,
    psf_of_images,
    scene_records,
)
from calibration.sharpness import read_limits
from simulation.arguments import ArgumentError, ArgumentTypeError, checked, kind_of
from standoff.library.call import (
    Call,
    FilePath,
    ImageLike,
    NoiseLike,
    Progress,
    camera_noise,
    listed_images,
    output_path,
    path_of,
)
from standoff.library.edges import EdgeSources, Reading, from_images, from_session, taken_with


@dataclass(frozen=True, slots=True, kw_only=True)
class _Request:
    """Photographs or a session, how to read them, and how to get the PSF from them.

    ``region`` returns the part of an image to use, None for all of it.
    """

    images: Sequence[ImageLike] | Session
    reading: Reading
    method: CalibrationMethod
    region: Callable[[EdgeImage], Region | None]
    zoom: float | None
    target: TargetChoice


@dataclass(frozen=True, slots=True, kw_only=True)
class _Calibrated:
    """The PSF, the camera it belongs to, and the photographs of the edge target, if any."""

    psf: PsfCalibration
    origin: PsfOrigin
    edges: EdgeSources | None = None


@checked
def calibrate_psf(
    images: ImageLike | Iterable[ImageLike] | Session,
    *,
    method: CalibrationMethod = "all-angles",
    zoom: float | None = None,
    region: Region | Literal["centre"] | None = None,
    target: TargetChoice = "auto",
    channel: Channel | None = None,
    bayer: Pattern | None = None,
    noise: NoiseLike | None = None,
    correct: CorrectionMaps | FilePath | None = None,
    pixel_pitch_um: float | None = None,
    white_level: float | None = None,
    limits: FilePath | None = None,
    labels: Mapping[str, str] | None = None,
    bench: FilePath | None = None,
    report: FilePath | None = None,
    reading: ReadOptions | None = None,
    progress: Progress | None = None,
) -> PsfCalibration:
    """Measure the camera's PSF, by default from photographs of straight edges at any angle.

    Parameters
    ----------
    images
        Arrays linear in light, or files; or a session, whose captures are used.
    method
        ``all-angles``: maximum likelihood on the raw pixels of the edges; ``paper``: medians over
        vertical and horizontal edges; ``single-image``: edges that a scene happens to contain;
        ``two-distance``: one scene from two or more distances, the nearest first.
    zoom
        Distance ratio of two photographs, for ``two-distance``; by default it is found from image
        features.
    region
        Part of each photograph to use; ``centre`` is the central half along both axes.
    target
        With ``auto``, edges of the scene beside a target do not count, and are flagged
        ``beside_target``; with ``all``, every edge counts.
    channel
        Channel of colour photographs to measure, by default ``luma``. Of a raw mosaic, the colour
        whose PSF is returned, by default ``green``.
    bayer
        Pattern of a raw mosaic whose file does not state it; each of its colours is measured.
    noise
        Noise of a capture, or the path of a noise.json, for photographs of unknown variance.
    correct
        Dark, flat and defect maps to apply first, or the path of their noise.json.
    pixel_pitch_um
        Pixel pitch in µm, for frequencies in lp/mm; by default as stated by the bench file or by
        Exif.
    white_level
        Level, as it is stored, at which photographs are clipped; by default the file's own. For
        floats, by default the level at which they were cut off, if they were.
    limits
        Path of a limits file (TOML) for pass and fail; the result's ``verdict`` compares with it.
    labels
        Names of the ``lens``, ``camera``, ``target``, ``customer`` and ``operator``, for the first
        page of the report; they are stored in psf.json.
    bench
        Path of a bench file (TOML) whose ``[labels]`` and ``[optics]`` supply what ``labels`` and
        ``pixel_pitch_um`` do not state; by default the session's own.
    report
        Path of a report on an edge target to write as well, HTML or PDF; for ``all-angles`` and
        ``paper`` only.
    reading
        How files are read; see ``standoff.reading``.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    PsfCalibration
        Total and optical PSF with standard errors; values that the photographs do not determine
        are None. ``notes`` are remarks; ``write_psf`` writes it to a file.

    Raises
    ------
    TypeError, ArgumentError
        If an argument has the wrong type, or two do not go together.
    CalibrationError
        If the photographs do not determine the PSF, or a file cannot be read.

    Examples
    --------
    >>> psf = standoff.calibrate_psf(["vertical.tif", "horizontal.tif"])
    >>> round(psf.sigma_x_px, 2), round(psf.sigma_y_px, 2)
    (0.94, 0.94)
    >>> psf.sigma_x_err_px < 0.02
    True
    """
    call = Call("calibrate_psf", progress, reading, (noise, correct, limits, bench), white_level)
    page = None if report is None else output_path(report, "report", PAGES)
    named = _named_by(labels, bench, images if isinstance(images, Session) else None)
    request = _Request(
        images=images if isinstance(images, Session) else listed_images(images),
        reading=named.stating_pitch(_reading(channel, bayer, noise, correct, pixel_pitch_um)),
        method=method,
        region=_region_rule(region),
        zoom=zoom,
        target=target,
    )
    _refuse_wrong_count(request)
    bounds = None if limits is None else read_limits(Path(limits))
    try:
        found = _METHODS[method](call, request)
    except ValueError as error:
        raise CalibrationError(str(error)) from error
    origin = replace(
        found.origin,
        region=None if region is None else str(region),
        provenance=call.provenance(),
        labels=named.labels,
    )
    psf = found.psf.with_origin(origin)
    if bounds is not None and limits is not None:
        psf = psf.judged(bounds, on_one_line(limits))
    if found.edges is not None:
        for remark in psf_remarks(psf):
            call.note(remark)
    psf = psf.model_copy(update={"notes": call.notes})
    if page is not None:
        _write_report(page, psf, found.edges)
    return psf


def _write_report(path: Path, psf: PsfCalibration, edges: EdgeSources | None) -> None:
    if edges is None:
        raise ArgumentError(f"report is for edge targets only, not for method {psf.method}")
    from analysis.reports import calibration_report  # loads what plots

    write_page(path, calibration_report(psf, edges.load, edges.session).html())


def _refuse_wrong_count(request: _Request) -> None:
    if isinstance(request.images, Session):
        return
    count = len(request.images)
    if request.zoom is not None and count != 2:
        raise ArgumentError("the distance ratio needs exactly two photographs")
    if request.method == "two-distance" and count < 2:
        raise ArgumentError("two-distance needs at least two photographs, the nearest first")


def _reading(
    channel: Channel | None,
    bayer: Pattern | None,
    noise: NoiseLike | None,
    correct: CorrectionMaps | FilePath | None,
    pixel_pitch_um: float | None,
) -> Reading:
    maps = correct
    if maps is not None and not isinstance(maps, CorrectionMaps):
        maps = read_correction(Path(maps))
    known = camera_noise(noise)
    return Reading(
        channel=channel or ("luma" if bayer is None else "green"),
        pattern=bayer,
        correction=maps,
        frame_noise=None if known is None else level_noise(known),
        pixel_pitch_um=pixel_pitch_um,
    )


def _region_rule(
    region: Region | Literal["centre"] | None,
) -> Callable[[EdgeImage], Region | None]:
    if region == "centre":
        return lambda source: Region.centre(*source.frame)
    return lambda _: region


@dataclass(frozen=True, slots=True, kw_only=True)
class _Scenes:
    """Photographs by scene, each with the nearest first, and what is known about the camera."""

    series: tuple[tuple[EdgeImage, ...], ...]
    origin: PsfOrigin

    @property
    def images(self) -> list[EdgeImage]:
        """All photographs, scene by scene."""
        return [image for scene in self.series for image in scene]

    @property
    def pairs(self) -> int:
        """Number of pairs of a scene's nearest photograph and a further one."""
        return sum(len(scene) - 1 for scene in self.series)


def _from_edges(call: Call, request: _Request) -> _Calibrated:
    assert request.method == "all-angles" or request.method == "paper"
    sources = (
        from_session(_listed(call, request.images), request.reading)
        if isinstance(request.images, Session)
        else from_images(request.images, request.reading, call)
    )
    reading = sources.reading
    selection = EdgeSelection(region=request.region, target=request.target)
    with call.bar("measuring edges", sources.count) as advance_to:
        if reading.pattern is None:
            calibration = psf_of_images(
                sources.images,
                method=request.method,
                selection=selection,
                progress=advance_to,
            )
        else:
            calibration = calibrate_mosaic(
                sources.images,
                reading.pattern,
                reading.channel,
                method=request.method,
                selection=selection,
                progress=advance_to,
            )
    return _Calibrated(
        psf=calibration,
        origin=taken_with(sources),
        edges=sources,
    )


def _from_scene(call: Call, request: _Request) -> _Calibrated:
    from calibration.blind import SCENE_ERR, calibrate_from_scene  # with what aligns photographs

    scenes = _scenes(call, request)
    with call.bar("measuring edges", len(scenes.images)) as advance_to:
        calibration = calibrate_from_scene(
            scenes.images, region=request.region, progress=advance_to
        )
    call.note(
        f"the errors include {100 * SCENE_ERR:.0f} % for edges that are soft in the scene itself; "
        "two distances or an edge target give more accurate results"
    )
    return _Calibrated(psf=calibration, origin=scenes.origin)


def _from_distances(call: Call, request: _Request) -> _Calibrated:
    from calibration.blind import calibrate_from_distances  # with what aligns photographs

    scenes = _scenes(call, request)
    if any(scene[0].noise is None for scene in scenes.series):
        call.note(
            "the noise of the photographs is unknown, and is estimated from the scatter of the "
            "further one; give --noise"
        )
    with call.bar("comparing distances", scenes.pairs) as advance_to:
        calibration = calibrate_from_distances(
            scenes.series, zoom=request.zoom, region=request.region, progress=advance_to
        )
    return _Calibrated(psf=calibration, origin=scenes.origin)


def _scenes(call: Call, request: _Request) -> _Scenes:
    reading = request.reading
    if not isinstance(request.images, Session):
        sources = from_images(request.images, reading, call)
        if sources.reading.pattern is not None:
            raise CalibrationError(
                "raw mosaics can be measured with edge targets only: --method all-angles or paper"
            )
        return _Scenes(series=(tuple(sources.images),), origin=sources.origin)
    session = _listed(call, request.images)
    records = scene_records(session)
    series = tuple(
        tuple(
            capture_images(
                session, scene, correction=reading.correction, frame_noise=reading.frame_noise
            )
        )
        for scene in records
    )
    origin = origin_of(session, [record for scene in records for record in scene])
    return _Scenes(series=series, origin=origin)


def _listed(call: Call, session: Session) -> Session:
    call.inputs.add_session(session)
    return session


_METHODS: dict[CalibrationMethod, Callable[[Call, _Request], _Calibrated]] = {
    "all-angles": _from_edges,
    "paper": _from_edges,
    "single-image": _from_scene,
    "two-distance": _from_distances,
}


LABELS = tuple(LabelsConfig.model_fields)
_LONGEST = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class _Named:
    """The labels, None without any, and the optics of a bench file that was given."""

    labels: dict[str, str] | None = None
    optics: OpticsConfig | None = None

    def stating_pitch(self, reading: Reading) -> Reading:
        """Return how edges are read, with the bench file's pixel pitch if none is given."""
        if self.optics is None or reading.pixel_pitch_um is not None:
            return reading
        pitch_um = self.optics.pixel_pitch_um
        return replace(reading, pixel_pitch_um=pitch_um, pixel_pitch_from="the bench file")


def _named_by(
    labels: Mapping[str, str] | None, bench: FilePath | None, session: Session | None
) -> _Named:
    """Return the labels that are given, and those of a bench file or of a session's."""
    given = _checked(labels or {})
    optics, found = None, {}
    if bench is not None:
        config = load_bench(Path(path_of(bench, "bench")))
        optics = config.optics
        found = {"lens": optics.lens} | (config.labels.model_dump() if config.labels else {})
    elif session is not None:
        known = (session.bench or {}).get("labels")
        found = known if isinstance(known, dict) else {}
    of_bench = {name: text for name, text in found.items() if name in LABELS and text}
    merged = of_bench | given
    return _Named(
        labels={name: merged[name] for name in LABELS if name in merged} or None, optics=optics
    )


def _checked(labels: Mapping[str, str]) -> dict[str, str]:
    found = {}
    for name, text in labels.items():
        if name not in LABELS:
            near = get_close_matches(str(name), LABELS, n=1)
            meant = f"; {near[0]} was probably meant" if near else ""
            raise ArgumentError(
                f"expected {', '.join(LABELS[:-1])} or {LABELS[-1]}, got {name!r}{meant}",
                argument="labels",
            )
        if not isinstance(text, str):
            raise ArgumentTypeError(f"{name} is a text, not {kind_of(text)}", argument="labels")
        said = on_one_line(text).strip()
        if not said or len(said) > _LONGEST:
            raise ArgumentError(
                f"{name} is a text of 1 to {_LONGEST} letters, got {len(said)}", argument="labels"
            )
        found[name] = said
    return found
