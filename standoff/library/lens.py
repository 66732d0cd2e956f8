"""The report of a lens and its camera: sharpness in all colours, noise, and both together."""

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from acquisition.files import PAGES, require_writable, write_file, write_page
from acquisition.photographs import ReadOptions
from acquisition.printable import on_one_line
from acquisition.session import Session
from calibration.choices import Channel, Pattern
from calibration.documents import write_document
from calibration.edges import EdgeImage, EdgeMeasurement, EdgeSelection, Region, plane_places
from calibration.errors import CalibrationError, LensFileError, NoiseError
from calibration.lens import (
    CapacityFigures,
    Colour,
    ColourFigures,
    EdgeOfColour,
    LensMeasurement,
    SharpeningFigures,
    StarFigures,
    StatedContrast,
    TextureFigures,
    ThroughFocus,
    camera_figures,
    capacity_figures,
    colour_figures,
    data_sheet,
    figure_rows,
    lateral_fields,
    lateral_shifts,
    star_figures,
    texture_figures,
    through_focus,
)
from calibration.noise import EmvaSheet, NoiseCalibration, NoiseMeasurement
from calibration.psf import PsfCalibration, edge_records, mosaic_plane
from calibration.sharpness import Picture, read_limits, sharpening_of, with_sharpness
from simulation.arguments import ArgumentError, checked
from simulation.arrays import FloatArray
from standoff.library.call import (
    Call,
    FilePath,
    ImageLike,
    NoiseLike,
    Progress,
    listed_images,
    output_path,
    stored_noise,
)
from standoff.library.edges import EdgeSources, Reading, edge_image, from_images, from_session
from standoff.library.noise import Frames, measure_noise
from standoff.library.psf_calibration import calibrate_psf

_COLOURS: tuple[Literal["red", "green", "blue"], ...] = ("red", "green", "blue")
_COLUMNS = (
    *("part", "colour", "image", "x_px", "y_px", "angle_deg"),
    *("figure", "value", "err", "unit", "is_model_free"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Noise:
    """The noise calibration, with the measurement that it is from if there was one."""

    calibration: NoiseCalibration | None = None
    measurement: NoiseMeasurement | None = None

    @property
    def sheet(self) -> EmvaSheet | None:
        """The data sheet; None without darks and flats."""
        return None if self.measurement is None else self.measurement.emva

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the frames."""
        return () if self.measurement is None else self.measurement.transfer.notes

    def of(self, given: "_Photographs") -> NoiseCalibration | None:
        """Return the noise of the photographs: of a session, for as many frames as they have."""
        if self.calibration is None or not isinstance(given.images, Session):
            return self.calibration
        frames = {record.frames_used for record in edge_records(given.images)}
        if len(frames) != 1:
            return self.calibration
        return self.calibration.model_copy(update={"frames_averaged": frames.pop()})


@dataclass(frozen=True, slots=True, kw_only=True)
class _Photographs:
    """Photographs or a session, and how the edges in them are found and read."""

    images: list[ImageLike] | Session
    region: Region | Literal["centre"] | None
    bayer: Pattern | None

    def list_session(self, call: Call) -> None:
        """List a session among what the figures are made from."""
        if isinstance(self.images, Session):
            call.inputs.add_session(self.images)

    def sources(self, call: Call) -> EdgeSources:
        """Return the photographs, each read when its turn comes."""
        if isinstance(self.images, Session):
            return from_session(self.images, Reading())
        channel: Channel = "luma" if self.bayer is None else "green"
        return from_images(self.images, Reading(channel=channel, pattern=self.bayer), call)

    def selection(self) -> EdgeSelection:
        """Return which edges count."""
        region = self.region
        if region == "centre":
            return EdgeSelection(region=lambda source: Region.centre(*source.frame))
        return EdgeSelection(region=lambda _: region)


_FEWEST_POSITIONS = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class _FocusSeries:
    """Edges of photographs at several focus positions, and the photographs nearest to the best."""

    edges: Sequence[EdgeMeasurement]
    positions_mm: Mapping[str, float]
    stated: StatedContrast
    sharpest: _Photographs

    @classmethod
    def of(
        cls, given: _Photographs, focus_mm: Sequence[float], stated: StatedContrast, call: Call
    ) -> "_FocusSeries":
        """Measure the edges of all photographs, each of which has its focus position."""
        if isinstance(given.images, Session):
            raise ArgumentError("a session has its heights instead", argument="focus_mm")
        if len(focus_mm) != len(given.images):
            raise ArgumentError(
                f"{len(given.images)} photographs, but {len(focus_mm)} focus positions",
                argument="focus_mm",
            )
        if len(set(focus_mm)) < _FEWEST_POSITIONS:
            raise ArgumentError(
                f"{_FEWEST_POSITIONS} different focus positions at least are needed, got "
                f"{len(set(focus_mm))}",
                argument="focus_mm",
            )
        sources, selection = given.sources(call), given.selection()
        edges: list[EdgeMeasurement] = []
        positions: dict[str, float] = {}
        frames: set[tuple[int, int]] = set()
        with call.bar("measuring focus", sources.count) as advance_to:
            for done, (image, position) in enumerate(
                zip(sources.images, focus_mm, strict=True), start=1
            ):
                frames.add(image.frame)
                edges += selection.measured_in(_focus_plane(image, given.bayer), "all-angles")
                positions[image.name] = float(position)
                advance_to(done)
        if len(frames) > 1:
            raise CalibrationError("photographs through focus must have one size")
        ((height, width),) = frames
        picture = Picture(width_px=width, height_px=height, pixel_pitch_um=None)
        found = through_focus(edges, positions, picture, stated, "focus")
        if found is None:
            raise CalibrationError(
                "no edge is sharpest between the first and the last focus position; photograph "
                f"the same edges on both sides of the focus, at {_FEWEST_POSITIONS} positions or "
                "more, in steps that neither blur edges away nor move them far"
            )
        nearest = min(focus_mm, key=lambda one: abs(one - found.best_mm.value))
        chosen = [
            image
            for image, position in zip(given.images, focus_mm, strict=True)
            if position == nearest
        ]
        call.note(
            f"all figures except those through focus are from the {len(chosen)} photograph"
            f"{'s' * (len(chosen) > 1)} at {nearest:g} mm, the position nearest to the best focus"
        )
        return cls(
            edges=edges,
            positions_mm=positions,
            stated=stated,
            sharpest=replace(given, images=chosen),
        )

    def measured(self, psf: PsfCalibration) -> ThroughFocus | None:
        """Return the figures, with the pixel pitch that the calibration knows."""
        return through_focus(self.edges, self.positions_mm, _picture(psf), self.stated, "focus")

    @staticmethod
    def of_heights(psf: PsfCalibration, stated: StatedContrast) -> ThroughFocus | None:
        """Return the figures of a session whose edges stand at several heights."""
        heights = {edge.image: edge.height_mm for edge in psf.edges if edge.height_mm is not None}
        return through_focus(psf.edges, heights, _picture(psf), stated, "height")


def _picture(psf: PsfCalibration) -> Picture:
    return Picture(
        width_px=psf.picture_width_px,
        height_px=psf.picture_height_px,
        pixel_pitch_um=psf.pixel_pitch_um,
    )


def _focus_plane(image: EdgeImage, bayer: Pattern | None) -> EdgeImage:
    """The plane whose focus is measured: of raw mosaics one of green."""
    pattern = bayer or image.pattern
    if pattern is None:
        return image
    return mosaic_plane(image, next(one for one in plane_places(pattern) if one.colour == "green"))


@checked
def measure_lens(
    images: ImageLike | Iterable[ImageLike] | Session,
    *,
    darks: Frames | None = None,
    flats: Frames | None = None,
    noise: NoiseLike | None = None,
    region: Region | Literal["centre"] | None = None,
    bayer: Pattern | None = None,
    focus_mm: Sequence[float] | None = None,
    depth_contrast: float = 0.2,
    depth_freq_cy_per_px: float = 0.25,
    leaves: ImageLike | None = None,
    pixel_pitch_um: float | None = None,
    limits: FilePath | None = None,
    labels: Mapping[str, str] | None = None,
    bench: FilePath | None = None,
    white_level: float | None = None,
    report: FilePath | None = None,
    reading: ReadOptions | None = None,
    progress: Progress | None = None,
) -> LensMeasurement:
    """Measure a lens and its camera for a report: sharpness by colour, noise, and both together.

    Parameters
    ----------
    images
        Photographs of straight edges, arrays linear in light or files; or a session, whose edge,
        dark and flat captures are used.
    darks, flats
        Single frames of the same camera at the same gain, as in ``measure_noise``.
    noise
        The noise of the camera, or the path of a noise.json, instead of ``darks`` and ``flats``;
        the data sheet of EMVA 1288 needs the frames.
    focus_mm
        Focus position of each photograph, of the sensor or the lens along the axis: five different
        ones at least, on both sides of the focus. All other figures are then those of the
        photographs nearest to the best focus. In a session with edges at five heights or more,
        heights count likewise.
    depth_contrast, depth_freq_cy_per_px
        Contrast, and its frequency, for which the depth of field is stated.
    leaves
        Picture of the dead leaves target (spilled coins) that photographs show beside edges, as its
        maker hands it over or as it was printed: an array linear in light, or a file.
    region, bayer, pixel_pitch_um, limits, labels, bench, white_level
        As in ``calibrate_psf``; the operator is by default that of the session.
    report
        Path of the report to write as well, HTML or PDF.
    reading
        How files are read; see ``standoff.reading``.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    LensMeasurement
        The figures of the edges in each colour, sharpening, lateral chromatic aberration, quanta
        and information, noise, focus over the field; ``write_lens`` writes them.

    Raises
    ------
    ArgumentError
        If two arguments do not go together.
    CalibrationError
        If the photographs or frames do not determine what is measured, or a file cannot be read.

    Examples
    --------
    >>> lens = standoff.measure_lens(["vertical.tif", "horizontal.tif"])
    >>> [(one.colour, round(one.median.mtf50_cy_per_px.value, 2)) for one in lens.colours]
    [('luma', 0.2), ('red', 0.2), ('green', 0.2), ('blue', 0.2)]
    >>> lens.sharpening.is_sharpened
    False
    """
    page = None if report is None else output_path(report, "report", PAGES)
    require_writable([page])
    given = _Photographs(
        images=images if isinstance(images, Session) else listed_images(images),
        region=region,
        bayer=bayer,
    )
    stated = StatedContrast(contrast=depth_contrast, freq_cy_per_px=depth_freq_cy_per_px)
    call = Call("measure_lens", progress, reading, (noise, limits, bench), white_level)
    bounds = None if limits is None else read_limits(Path(limits))
    series = None if focus_mm is None else _FocusSeries.of(given, focus_mm, stated, call)
    given = series.sharpest if series else given
    given.list_session(call)
    target = _target_of(leaves, given, call)
    known = _noise_of(given, {"darks": darks, "flats": flats}, noise, call, progress)
    psf = calibrate_psf(
        given.images,
        region=region,
        bayer=bayer,
        pixel_pitch_um=pixel_pitch_um,
        labels=labels,
        bench=bench,
        white_level=white_level,
        reading=reading,
        progress=progress,
    )
    psf = _named_by_session(psf, given.images)
    for remark in (*psf.notes, *known.notes):
        call.announce(remark)
    sources = given.sources(call)
    seen = _seen_again(given, psf, sources, target, call)
    sharpening = sharpening_of(psf.edges_used)
    capacity = _capacity_of(psf, known.of(given), seen, call)
    focus = _FocusSeries.of_heights(psf, stated) if series is None else series.measured(psf)
    if bounds is not None and limits is not None:
        figures = camera_figures(
            sharpening, capacity, known.calibration, known.sheet, focus, seen.textures
        )
        psf = psf.judged(bounds, on_one_line(limits), figures)
    lens = LensMeasurement(
        labels=psf.labels,
        picture_width_px=psf.picture_width_px,
        picture_height_px=psf.picture_height_px,
        pixel_pitch_um=psf.pixel_pitch_um,
        **seen._asdict(),
        sharpening=None if sharpening is None else SharpeningFigures.of(sharpening),
        lateral_colour=lateral_shifts(psf.edges_used),
        lateral_fields=lateral_fields(psf.edges_used, _picture(psf)),
        capacity=capacity,
        noise=known.calibration,
        emva=() if known.sheet is None else data_sheet(known.sheet),
        through_focus=focus,
        verdict=psf.verdict,
        provenance=call.provenance(),
        psf=psf,
        noise_measurement=known.measurement,
        notes=call.notes,
    )
    _write_page(page, lens, sources)
    return lens


def _write_page(page: Path | None, lens: LensMeasurement, sources: EdgeSources) -> None:
    if page is None:
        return
    from analysis.reports import lens_report  # loads what plots

    write_page(page, lens_report(lens, sources.load, sources.session).html())


def _named_by_session(psf: PsfCalibration, images: list[ImageLike] | Session) -> PsfCalibration:
    """Return the calibration with the operator of its session, if no other is stated."""
    if not isinstance(images, Session) or not images.manifest.operator:
        return psf
    labels = {"operator": images.manifest.operator} | (psf.labels or {})
    return psf.model_copy(update={"labels": labels})


def _noise_of(
    given: _Photographs,
    frames: Mapping[str, Frames | None],
    noise: NoiseLike | None,
    call: Call,
    progress: Progress | None,
) -> _Noise:
    """Return what is known of the camera's noise."""
    stated = [name for name, value in frames.items() if value is not None]
    if stated and noise is not None:
        raise ArgumentError(f"give either noise or {stated[0]}", argument="noise")
    if stated:
        found = measure_noise(**frames, reading=call.inputs.options, progress=progress)  # type: ignore[arg-type]  # each is frames
        call.inputs.add_all(found.calibration.provenance)
        return _Noise(calibration=found.calibration, measurement=found)
    if noise is not None:
        stored = stored_noise(noise)
        if not isinstance(stored, NoiseCalibration):
            raise ArgumentError("expected a noise calibration or its file", argument="noise")
        return _Noise(calibration=stored)
    if isinstance(given.images, Session):
        kinds = {one.kind for one in given.images.records if one.frames_used > 1}
        if not {"dark", "flat"} <= kinds:
            call.note("the session has no darks and flats: noise is that of the edges alone")
            return _Noise()
        try:
            found = measure_noise(given.images, progress=progress)
        except NoiseError as error:
            call.note(f"the session's darks and flats are not used: {error}")
            return _Noise()
        return _Noise(calibration=found.calibration, measurement=found)
    return _Noise()


def _capacity_of(
    psf: PsfCalibration, noise: NoiseCalibration | None, seen: "_Seen", call: Call
) -> CapacityFigures | None:
    """Return quanta and information; none of raw mosaics, nor where texture is lost."""
    if any(one.is_lost for one in seen.textures):
        call.note(
            "no noise-equivalent quanta: texture loses contrast that edges keep, as after noise "
            "reduction; give raw or linear files, with edges on all sides of the target"
        )
        return None
    if psf.channels:
        call.note(
            "no noise-equivalent quanta for raw mosaics: each colour has only every second pixel"
        )
        return None
    capacity, remarks = capacity_figures(psf, noise)
    for remark in remarks:
        call.note(remark)
    return capacity


def _target_of(leaves: ImageLike | None, given: _Photographs, call: Call) -> FloatArray | None:
    """The picture of dead leaves, linear in light."""
    if leaves is None:
        return None
    if isinstance(given.images, Session):
        raise ArgumentError("a session is not searched for dead leaves", argument="leaves")
    picture = edge_image(call.photograph(leaves, "leaves"), Reading())
    if not np.ptp(picture.image_dn) > 0:
        raise CalibrationError(
            f"{picture.name}: one grey all over; give the picture of the dead leaves target"
        )
    return picture.image_dn


class _Seen(NamedTuple):
    """What photographs show beside the edges of the PSF."""

    colours: tuple[ColourFigures, ...]
    edges: tuple[EdgeOfColour, ...]
    stars: tuple[StarFigures, ...]
    textures: tuple[TextureFigures, ...]


def _seen_again(
    given: _Photographs,
    psf: PsfCalibration,
    sources: EdgeSources,
    target: FloatArray | None,
    call: Call,
) -> _Seen:
    """Return the figures of every colour, those of the PSF first; targets of grey or luma.

    Every photograph is read once more, which ``sources`` needs to read it again by its name.
    """
    others: dict[Colour, list[EdgeMeasurement]] = {}
    stars: list[StarFigures] = []
    textures: list[TextureFigures] = []
    main: Colour = "green" if psf.channels else "grey"
    selection = given.selection()
    with call.bar("measuring colours", sources.count) as advance_to:
        for done, image in enumerate(sources.images, start=1):
            if sources.session is None and sources.reading.pattern is None:
                used = [edge for edge in psf.edges_used if edge.image == image.name]
                star = star_figures(image.name, image.image_dn, used)
                stars += () if star is None else (star,)
                if target is not None:
                    texture = texture_figures(image, target, used)
                    textures += () if texture is None else (texture,)
            for colour, plane in _planes(image, sources.reading.pattern):
                if psf.channels is None:
                    main = "luma"
                if colour != main:
                    found = selection.measured_in(plane, "all-angles")
                    others.setdefault(colour, []).extend(with_sharpness(found, plane))
            advance_to(done)
    by_colour: dict[Colour, Sequence[EdgeMeasurement]] = {main: psf.edges}
    by_colour |= {name: others[name] for name in _COLOURS if name in others}
    if target is not None and not textures:
        call.note(_no_leaves(sources))
    return _Seen(*colour_figures(by_colour), tuple(stars), tuple(textures))


def _no_leaves(sources: EdgeSources) -> str:
    if sources.reading.pattern is not None:
        return "raw mosaics are not searched for dead leaves"
    return (
        "no photograph shows the dead leaves of the given picture in focus and not clipped, with a "
        "side of at least 170 px (200 px if turned)"
    )


def _planes(image: EdgeImage, pattern: Pattern | None) -> Iterator[tuple[Colour, EdgeImage]]:
    """Yield the colours of a photograph; none of a grey one, even if it is stored as colour."""
    if pattern is not None:
        for place in plane_places(pattern):
            yield place.colour, mosaic_plane(image, place)
        return
    colours = image.colours_dn
    if colours is None or not np.any(np.ptp(colours, axis=2)):
        return
    for number, colour in enumerate(_COLOURS):
        plane = np.asarray(colours[:, :, number], dtype=np.float64)
        yield (
            colour,
            replace(image, image_dn=plane, noise=None, compression=None, colours_dn=None),
        )


@checked
def write_lens(path: FilePath, lens: LensMeasurement) -> None:
    """Write the figures of a lens: all of them as JSON, or as CSV, one figure a row.

    Parameters
    ----------
    path
        Path of the file to write, ``.json`` or ``.csv``.
    lens
        As ``measure_lens`` returns it.

    Raises
    ------
    LensFileError
        If the file cannot be written.

    Examples
    --------
    >>> lens = standoff.measure_lens("vertical.tif")
    >>> standoff.write_lens("lens.csv", lens)
    """
    target: Path = output_path(path, "path", {".json", ".csv"})
    if target.suffix.lower() == ".json":
        write_document(target, lens, LensFileError)
        return
    text = StringIO(newline="")
    table = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    table.writeheader()
    table.writerows(figure_rows(lens))
    write_file(target, text.getvalue().encode("utf-8"))
