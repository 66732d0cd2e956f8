"""Edges of photographs and of sessions, and the table of what is measured on them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition import Session as Session
from acquisition.files import write_file
from acquisition.photographs import (
    UNNAMED_MOSAIC,
    Photograph,
    PhotographFacts,
    ReadOptions,
    luma_plane,
    shared_facts,
)
from calibration.choices import Channel, Pattern
from calibration.edges import (
    EdgeImage,
    EdgeMeasurement,
    JpegCompression,
    Method,
    Region,
    edges_of_image,
    plane_places,
)
from calibration.errors import CalibrationError
from calibration.noise import CorrectionMaps, LevelNoise, fit_level_noise
from calibration.psf import (
    PsfCalibration,
    PsfOrigin,
    edge_images,
    edge_records,
    origin_of,
)
from calibration.sharpness import with_sharpness
from simulation.arguments import ArgumentError, checked
from simulation.arrays import FloatArray
from standoff.library.call import (
    Call,
    FilePath,
    ImageLike,
    output_path,
    photograph,
    with_white_level,
)

_CLIPPED_FROM = 0.995  # of the saturation level


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """How the planes of a photograph become the one that is measured.

    Of a mosaic (``pattern``), all colours are measured; ``channel`` is the one shown.
    ``correction`` are maps of the sensor to apply, ``frame_noise`` is the noise of one frame, for
    photographs that do not state it. ``pixel_pitch_um`` is stated by what ``pixel_pitch_from``
    names, and takes precedence over the pitch that a session or a photograph states.
    """

    channel: Channel = "luma"
    pattern: Pattern | None = None
    correction: CorrectionMaps | None = None
    frame_noise: LevelNoise | None = None
    pixel_pitch_um: float | None = None
    pixel_pitch_from: str = "--pixel-pitch-um"


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeSources:
    """The photographs, read one at a time, and a way to read one again by name."""

    count: int
    images: Iterator[EdgeImage]
    load: Callable[[str], NDArray[np.floating[Any]]]
    origin: PsfOrigin
    reading: Reading
    session: Session | None = None
    taken: Sequence[PhotographFacts] = ()


def from_session(session: Session, reading: Reading) -> EdgeSources:
    """Return the edge captures of a session."""
    records = {record.file: record for record in edge_records(session)}

    def load(name: str) -> NDArray[np.floating[Any]]:
        mean_dn: NDArray[np.floating[Any]] = session.load(records[name]).mean_dn
        if reading.correction is not None:
            mean_dn = reading.correction.correct(mean_dn)
        return _shown(mean_dn, reading)

    origin = origin_of(session, list(records.values()))
    stated_um, stated_by = _stated_pitch(reading, origin.photograph or {}, "the bench file")
    images = edge_images(session, correction=reading.correction, frame_noise=reading.frame_noise)
    return EdgeSources(
        count=len(records),
        images=(replace(image, pixel_pitch_um=stated_um) for image in images),
        load=load,
        origin=replace(
            origin,
            channel=reading.channel if reading.pattern else None,
            pixel_pitch_um=stated_um,
            pixel_pitch_from=stated_by,
        ),
        reading=reading,
        session=session,
    )


def from_images(given: Sequence[ImageLike], reading: Reading, call: Call) -> EdgeSources:
    """Return photographs of edges, each read when its turn comes.

    Camera raw files state the pattern of their mosaic; the first file decides for all.
    """
    if reading.pattern is not None:
        call.inputs.leave_unsaid(UNNAMED_MOSAIC)
    first = call.photograph(given[0], "images[0]")
    if reading.pattern is None and first.pattern is not None:
        channel: Channel = "green" if reading.channel == "luma" else reading.channel
        reading = replace(reading, pattern=first.pattern, channel=channel)
    taken: list[PhotographFacts] = []
    by_name: dict[str, ImageLike] = {}
    waiting = [first]

    def images() -> Iterator[EdgeImage]:
        for number, image in enumerate(given):
            name = f"images[{number}]"
            photograph = waiting.pop() if waiting else call.photograph(image, name)
            by_name[photograph.name] = image
            taken.append(photograph.facts)
            if reading.channel == "luma" and photograph.is_colour:
                call.note(
                    "colour photographs are read as Rec. 601 luma; --channel of standoff calibrate "
                    "picks one colour"
                )
            plane = edge_image(photograph, reading)
            # Neither the file's own levels nor the last image stay in memory beside the next one.
            del photograph
            yield plane
            del plane

    def load(name: str) -> NDArray[np.floating[Any]]:
        return _shown(edge_image(call.photograph(by_name[name], name), reading).image_dn, reading)

    channel_read = reading.channel if reading.pattern or reading.channel != "luma" else None
    return EdgeSources(
        count=len(given),
        images=images(),
        load=load,
        origin=PsfOrigin(channel=channel_read),
        reading=reading,
        taken=taken,
    )


def taken_with(sources: EdgeSources) -> PsfOrigin:
    """Return the origin with what the photographs state, once all of them are read."""
    if sources.session is not None:
        return sources.origin
    facts = shared_facts(sources.taken)
    pitch_um, stated_by = _stated_pitch(sources.reading, facts, "EXIF")
    times = sorted(each.taken for each in sources.taken if each.taken)
    if times:
        facts["taken"] = times[0].replace(":", "-", 2)  # Exif writes 2026:11:22 13:14:15
    return replace(
        sources.origin,
        photograph=facts or None,
        pixel_pitch_um=pitch_um,
        pixel_pitch_from=stated_by,
    )


def _stated_pitch(
    reading: Reading, facts: Mapping[str, object], source: str
) -> tuple[float | None, str | None]:
    """The pixel pitch and what states it: the caller, or ``source``."""
    if reading.pixel_pitch_um is not None:
        return reading.pixel_pitch_um, reading.pixel_pitch_from
    pitch = facts.get("pixel_pitch_um")
    return (float(pitch), source) if isinstance(pitch, int | float) else (None, None)


def edge_image(photograph: Photograph, reading: Reading) -> EdgeImage:
    """Return a photograph of edges as a plane linear in light, with its clipped pixels."""
    _refuse_other_mosaic(photograph, reading)
    channel = "luma" if reading.pattern is not None else reading.channel
    saturation = photograph.saturation_dn
    planes = photograph.linear_planes
    try:
        plane = luma_plane(planes, channel)
        noise = _noise_of(photograph, plane, channel) or reading.frame_noise
    except ValueError as error:
        raise CalibrationError(f"{photograph.name}: {error}") from error
    clipped = None
    if reading.correction is not None:
        if photograph.is_colour:
            raise CalibrationError(
                f"{photograph.name}: a colour image, but the maps are of a grey camera; "
                "leave out --correct"
            )
        clipped = None if saturation is None else plane >= saturation
        try:
            plane = reading.correction.correct(plane)
        except ValueError as error:
            raise CalibrationError(f"{photograph.name}: {error}") from error
    elif channel == "luma" and photograph.is_colour and saturation is not None:
        # One clipped colour bends the luma, though the luma itself stays below the top.
        colours = np.asarray(planes, dtype=np.float64)
        clipped = np.asarray(((colours >= _CLIPPED_FROM * saturation) | (colours <= 0)).any(axis=2))
    return EdgeImage(
        name=photograph.name,
        image_dn=plane,
        noise=noise,
        saturation_dn=saturation,
        is_jpeg=photograph.is_jpeg,
        compression=_compression_of(photograph, reading),
        clipped=clipped,
        masked=photograph.masked,
        pixel_pitch_um=reading.pixel_pitch_um or photograph.facts.pixel_pitch_um,
        colours_dn=planes if photograph.is_colour else None,
    )


def _compression_of(photograph: Photograph, reading: Reading) -> JpegCompression | None:
    """How the measured plane was compressed, where it is the luma of a JPEG as it was stored."""
    steps = photograph.luma_steps
    is_luma = reading.pattern is None and reading.channel == "luma" and reading.correction is None
    if steps is None or not is_luma:
        return None
    greys = np.arange(256.0).reshape(256, 1)
    if photograph.is_colour:
        greys = np.repeat(greys[:, :, np.newaxis], 3, axis=2)
    levels_dn = luma_plane(photograph.encoding.decode(greys, photograph.white_dn))[:, 0]
    if not np.all(np.diff(levels_dn) > 0):
        return None  # a profile whose curve is flat somewhere: codes do not follow from levels
    return JpegCompression(steps=steps, code_levels_dn=levels_dn)


def _refuse_other_mosaic(photograph: Photograph, reading: Reading) -> None:
    if reading.pattern is not None and photograph.is_colour:
        raise CalibrationError(
            f"{photograph.name}: a colour photograph is not a raw mosaic; leave out --bayer"
        )
    if photograph.pattern not in (None, reading.pattern):
        raise CalibrationError(
            f"{photograph.name}: a raw mosaic of pattern {photograph.pattern}, where "
            f"{reading.pattern or 'no mosaic'} is expected"
        )


def _noise_of(photograph: Photograph, plane: FloatArray, channel: Channel) -> LevelNoise | None:
    """The noise of the mean that a stack or a capture holds; None for a single frame."""
    variance = photograph.grey_variance_dn2
    if variance is None or channel != "luma":
        return None
    top = photograph.saturation_dn or np.inf
    single = fit_level_noise(plane, variance, top)
    return single.averaged(photograph.frames)


def _shown(image: NDArray[np.floating[Any]], reading: Reading) -> NDArray[np.floating[Any]]:
    """The image as figures show it: for a mosaic the pixels of one colour, NaN elsewhere."""
    if reading.pattern is None:
        return image
    shown = np.full(image.shape, np.nan)
    for plane in plane_places(reading.pattern):
        if plane.colour == reading.channel:
            part = np.s_[plane.first_y_px :: 2, plane.first_x_px :: 2]
            shown[part] = image[part]
    return shown


@checked
def measure_edges(
    image: ImageLike,
    *,
    method: Method = "all-angles",
    region: Region | None = None,
    white_level: float | None = None,
    reading: ReadOptions | None = None,
) -> tuple[EdgeMeasurement, ...]:
    """Find the straight edges of one photograph and measure the blur across each.

    Parameters
    ----------
    image
        An array or a file, linear in light.
    method, region, white_level, reading
        As in ``calibrate_psf``.

    Returns
    -------
    tuple of EdgeMeasurement
        All edges found; those that are not used have a flag that says why.

    Raises
    ------
    TypeError
        If the image is neither an array nor a path.

    Examples
    --------
    >>> [round(edge.sigma_px, 2) for edge in standoff.measure_edges("vertical.tif")]
    [0.94, 0.93]
    """
    source = edge_image(
        photograph(image, options=with_white_level(reading, white_level)), Reading()
    )
    if region is not None:
        try:
            source.refuse_beyond_frame(region)
        except ValueError as error:
            raise ArgumentError(str(error), argument="region") from error
    return tuple(with_sharpness(edges_of_image(source, region, method), source))


@checked
def write_edge_table(path: FilePath, psf: PsfCalibration) -> None:
    """Write the edges of a calibration as CSV, one row per edge, with their SFR.

    Parameters
    ----------
    path
        Path of the file to write.
    psf
        A calibration, as ``calibrate_psf`` returns it.

    Raises
    ------
    ApplicationError
        If the file cannot be written.

    Examples
    --------
    >>> standoff.write_edge_table("edges.csv", standoff.calibrate_psf("vertical.tif"))
    """
    from analysis.reports import edge_csv  # loads what plots

    write_file(output_path(path, "path", {".csv"}), edge_csv(psf).encode("utf-8"))
