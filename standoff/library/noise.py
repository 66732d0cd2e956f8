"""Photon transfer and correction maps, from darks and flats of a session or of other frames."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from glob import has_magic
from itertools import chain, islice
from math import log2
from numbers import Number
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from acquisition.files import PAGES, require_writable, write_page
from acquisition.photographs import IMAGE_SUFFIXES, Photograph, ReadOptions, frames_of
from acquisition.printable import on_one_line
from acquisition.session import Session
from analysis.reports import noise_report
from calibration.errors import NoiseError
from calibration.noise import (
    FrameGroup,
    NoiseCaptures,
    NoiseKind,
    NoiseMeasurement,
    noise_captures,
    noise_of_captures,
)
from simulation.arguments import (
    ArgumentError,
    ArgumentTypeError,
    accepted,
    checked,
    is_array_like,
    kind_of,
)
from simulation.arrays import AnyArray
from standoff.errors import ImageFileError
from standoff.library.call import (
    Call,
    FilePath,
    Progress,
    opened_session,
    output_path,
    path_of,
    photograph,
)

Frames: TypeAlias = (
    FilePath | NDArray[Any] | Photograph | Iterable[object] | Mapping[str | float, object]
)
"""Frames of one level or of several.

A folder, a pattern such as ``flats/*.tif``, a file with a stack, or an array ``(frames, rows,
cols)``; a list of frames, files or arrays. Several levels are a folder of folders, a list or a
mapping of any of these; the numbers of a mapping are exposures in µs.
"""

_SAME_EXPOSURE = 1e-3
"""Relative: some cameras state what they measured."""
_OTHER_EXPOSURE = 0.1
"""Relative: files state it to a tenth at the worst, as 1/60 s for 1/64."""
_US_PER_S = 1e6
_SHUTTER_SPEEDS = (
    *(1.0, 1.25, 1.3, 1.6, 5 / 3, 2.0, 2.5, 3.0, 3.2, 10 / 3, 4.0, 5.0, 6.0, 8.0, 10.0, 13.0, 15.0),
    *(20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 125.0, 160.0, 200.0, 250.0, 320.0, 400.0),
    *(500.0, 640.0, 800.0, 1e3, 1250.0, 1600.0, 2e3, 2500.0, 3200.0, 4e3, 5e3, 6400.0, 8e3),
)
"""What a camera's dial shows for 2^(n/3), of seconds and as their reciprocals."""
_SAME_NAME = 2e-3
_OTHER_STEP = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class _Given:
    """Frames that were given together, before any is read.

    ``is_one_level`` says that the caller made a level of them; else every exposure that their files
    state is one.
    """

    name: str
    sources: Sequence[object]
    exposure_us: float | None = None
    is_one_level: bool = True


def _frame_captures(
    call: Call,
    given: Mapping[NoiseKind, Frames],
    exposures_us: Mapping[NoiseKind, Sequence[float] | None],
) -> NoiseCaptures:
    """Read darks and flats, and return their levels, with the exposures that are stated."""
    levels = [
        (kind, level)
        for kind, frames in given.items()
        for level in _stated(list(_levels(frames, f"{kind}s")), exposures_us[kind], kind)
    ]
    total = sum(len(level.sources) for _, level in levels)
    reading = _Reading(call)
    with call.bar("reading frames", total) as advance_to:
        for kind, level in levels:
            reading.read(kind, level)
            advance_to(reading.sources)
    return reading.captures()


def _levels(frames: object, name: str) -> Iterator[_Given]:
    """What was given for ``darks`` or ``flats``, level by level."""
    if isinstance(frames, Mapping):
        if not frames:
            raise ArgumentError("expected at least one level, got none", argument=name)
        for key, value in frames.items():
            is_number = isinstance(key, Number)
            exposure = accepted("exposure_us", key, float) if is_number else None
            sources = _sources(value, name)
            yield _Given(name=f"{name}[{key!r}]", sources=sources, exposure_us=exposure)
    elif isinstance(frames, str | PathLike):
        path = path_of(frames, name)
        inside = _folders(path)
        for folder in inside:
            yield _Given(name=on_one_line(folder), sources=_files(folder))
        if not inside:
            files = _files(path)
            yield _Given(name=on_one_line(path), sources=files, is_one_level=False)
    elif is_array_like(frames) and np.ndim(cast("Any", frames)) == 4:
        for index, stack in enumerate(cast("Iterable[object]", frames)):
            yield _Given(name=f"{name}[{index}]", sources=[stack])
    elif is_array_like(frames) or isinstance(frames, Photograph):
        yield _Given(name=name, sources=[frames])
    elif isinstance(frames, Iterable):
        yield from _listed(list(frames), name)
    else:
        raise ArgumentTypeError(
            f"expected a folder, files, arrays or a mapping of them, got {kind_of(frames)}",
            argument=name,
        )


def _listed(items: list[object], name: str) -> Iterator[_Given]:
    """A list of frames is one level, a list of levels several."""
    if not items:
        raise ArgumentError("expected at least one frame, got none", argument=name)
    single = [_is_frame(item) for item in items]
    if all(single):
        yield _Given(name=name, sources=items, is_one_level=False)
        return
    if any(single):
        raise ArgumentError(
            "some of its values are single frames, others levels of several; give one or the other",
            argument=name,
        )
    for index, item in enumerate(items):
        is_path = isinstance(item, str | PathLike)
        shown = on_one_line(path_of(item, name)) if is_path else f"{name}[{index}]"
        yield _Given(name=shown, sources=_sources(item, name))


def _is_frame(item: object) -> bool:
    """Whether an item of a list is a frame, or a file, and not a whole level."""
    if isinstance(item, str | PathLike):
        path = Path(item)
        return not path.is_dir() and not _is_pattern(path)
    if is_array_like(item):
        return np.ndim(cast("Any", item)) < 3
    return isinstance(item, Photograph) or not isinstance(item, Iterable)


def _sources(value: object, name: str) -> list[object]:
    """The files and arrays of one level."""
    if isinstance(value, str | PathLike):
        return list(_files(path_of(value, name)))
    if is_array_like(value) or isinstance(value, Photograph):
        return [value]
    if isinstance(value, Mapping) or not isinstance(value, Iterable):
        raise ArgumentTypeError(
            f"expected a folder, files or arrays, got {kind_of(value)}", argument=name
        )
    listed = list(value)
    if not listed:
        raise ArgumentError("a level without frames", argument=name)
    return listed


def _is_pattern(path: Path) -> bool:
    return has_magic(str(path)) and not path.exists()


def _is_image(path: Path) -> bool:
    return path.is_file() and path.suffix.lower() in IMAGE_SUFFIXES and path.name[0] != "."


def _folders(path: Path) -> list[Path]:
    """The folders of frames in a folder that holds no frames itself."""
    if not path.is_dir():
        return []
    inside = sorted(
        one for one in path.iterdir() if one.is_dir() and any(map(_is_image, one.iterdir()))
    )
    if inside and any(map(_is_image, path.iterdir())):
        raise ImageFileError(
            f"{on_one_line(path)}: frames and folders of frames ({on_one_line(inside[0].name)}); "
            "put each level into a folder of its own, or give a pattern"
        )
    return inside


def _files(path: Path) -> list[Path]:
    """The image files that a path stands for, in the order of their names."""
    if path.is_dir():
        found = sorted(one for one in path.iterdir() if _is_image(one))
        if not found:
            raise ImageFileError(f"{on_one_line(path)}: no image files in this folder")
        return found
    if not _is_pattern(path):
        return [path]
    base = Path(path.anchor or ".")
    pattern = str(path.relative_to(base)) if path.anchor else str(path)
    found = sorted(one for one in base.glob(pattern) if _is_image(one))
    if not found:
        raise ImageFileError(f"{on_one_line(path)}: no image file has such a name")
    return found


def _stated(
    levels: list[_Given], exposures_us: Sequence[float] | None, kind: NoiseKind
) -> list[_Given]:
    """The levels with the exposures that are stated beside them."""
    if exposures_us is None:
        return levels
    argument = f"{kind}_exposures_us"
    if len(exposures_us) != len(levels):
        raise ArgumentError(
            f"{len(exposures_us)} for {len(levels)} levels of {kind}s: one for each is expected",
            argument=argument,
        )
    if any(level.exposure_us is not None for level in levels):
        raise ArgumentError("the mapping has exposures already", argument=argument)
    return [
        _Given(name=level.name, sources=level.sources, exposure_us=exposure)
        for level, exposure in zip(levels, exposures_us, strict=True)
    ]


@dataclass(slots=True, kw_only=True)
class _Settings:
    """What all frames have in common."""

    isos: set[float] = field(default_factory=set)
    cameras: set[str] = field(default_factory=set)
    saturations_dn: set[float] = field(default_factory=set)
    is_mosaic: bool = False


class _Reading:
    """Reads frames into levels, each once."""

    def __init__(self, call: Call) -> None:
        self._call = call
        self._groups: dict[str, FrameGroup] = {}
        self._settings = _Settings()
        self.sources = 0

    def read(self, kind: NoiseKind, given: _Given) -> None:
        """Read what was given together."""
        found: dict[str, FrameGroup] = {}
        for source in given.sources:
            self.sources += 1
            frames = self._frames(source, f"{kind}s")
            first = list(islice(frames, 2))
            is_stack = len(first) > 1
            for frame in chain(first, frames):
                levels_dn = self._levels_dn(frame)
                name = frame.name if is_stack and not given.is_one_level else given.name
                exposure_us = _exposure_us(frame)
                if exposure_us is not None and not given.is_one_level:
                    name = f"{name}, {exposure_us:g} us"
                if name not in found:
                    found[name] = self._new_group(kind, name, given.exposure_us, exposure_us)
                group = found[name]
                if given.exposure_us is None:
                    _refuse_other_exposure(frame, exposure_us, group)
                group.add(levels_dn)
        if len(found) > 1:
            self._call.note(f"{given.name}: {len(found)} levels of {kind}s")
        for name, group in found.items():
            if name in self._groups:
                raise ArgumentError(f"{name} is given twice", argument=f"{kind}s")
            group.finish()
            self._groups[name] = group

    def captures(self) -> NoiseCaptures:
        """All that was read, as the captures of a measurement."""
        if any(group.exposure_us is None for group in self._groups.values()):
            self._call.note(
                "exposures are not stated by the files: no linearity, no dark current; state them "
                "in the order of the levels (--dark-exposure-us, --flat-exposure-us)"
            )
        found, stated = self._settings, self._call.inputs.options.white_level
        for what, values in (("ISO", found.isos), ("camera", found.cameras)):
            if len(values) > 1:
                listed = ", ".join(str(value) for value in sorted(values, key=str))
                raise NoiseError(
                    f"darks and flats of more than one {what} ({listed}); a noise.json applies to "
                    "one camera at one gain",
                    reason="settings",
                )
        if not found.saturations_dn:
            raise ArgumentError(
                "floating-point levels do not show where the camera clips: give the white level",
                argument="white_level",
            )
        top_dn = min(found.saturations_dn)
        groups = list(self._groups.values())
        notes = []
        if stated is None and max(group.max_dn for group in groups) < top_dn:
            notes.append(
                f"no frame reaches {top_dn:g}, the largest level that the files can hold: if the "
                "camera clips below it, state its white level"
            )
        notes += self._shutter_note(groups)
        if found.is_mosaic:
            notes.append("in raw mosaics, one green pixel of every square of four is measured")
        return noise_captures(
            groups,
            max_level_dn=top_dn,
            camera=next(iter(found.cameras), None),
            notes=tuple(notes),
        )

    def _shutter_note(self, groups: Sequence[FrameGroup]) -> list[str]:
        """What to say of flats whose exposures are the names of a photographic camera's speeds."""
        stated = {group.exposure_us for group in groups if group.kind == "flat"}
        off = [_off_its_name(us) for us in stated if us is not None]
        known = [ratio for ratio in off if ratio is not None]
        spread = max(known) / min(known) - 1 if len(known) > 1 else 0.0
        if not self._settings.isos or len(known) < len(stated) or spread < _OTHER_STEP:
            return []
        return [
            "the files state nominal shutter speeds, such as 1/60 s for 1/64 s: relative to each "
            f"other the exposures may be off by {100 * spread:.1f} %, and so may the linearity; "
            "state the true exposures"
        ]

    def _frames(self, source: object, name: str) -> Iterator[Photograph]:
        if isinstance(source, str | PathLike):
            yield from self._call.inputs.frames(path_of(source, name))
        elif isinstance(source, Photograph):
            yield photograph(source, name, self._call.inputs.options)
        else:
            yield from frames_of(source, name, self._call.inputs.options)

    def _new_group(
        self, kind: NoiseKind, name: str, stated_us: float | None, own_us: float | None
    ) -> FrameGroup:
        """A level, at the exposure that is stated, or else that of its files."""
        if stated_us and own_us and abs(own_us / stated_us - 1) > _OTHER_EXPOSURE:
            self._call.note(f"{name}: taken as {stated_us:g} us; its files say {own_us:g} us")
        return FrameGroup(kind, name, own_us if stated_us is None else stated_us)

    def _levels_dn(self, frame: Photograph) -> AnyArray:
        """The levels of a frame as the camera gave them."""
        settings, facts = self._settings, frame.facts
        _refuse_processed(frame)
        if facts.iso is not None:
            settings.isos.add(facts.iso)
        if facts.camera is not None:
            settings.cameras.add(facts.camera)
        is_stated = self._call.inputs.options.white_level is not None
        if frame.saturation_dn is not None and (is_stated or frame.full_scale_dn is not None):
            settings.saturations_dn.add(frame.saturation_dn)
        levels = frame.stored
        if frame.pattern is not None:
            settings.is_mosaic = True
            row, col = divmod(frame.pattern.index("G"), 2)
            return levels[row::2, col::2]
        return levels if levels.ndim == 2 else levels[:, :, 0]


def _off_its_name(exposure_us: float) -> float | None:
    """Ratio of the step of 2^(n/3) s to the speed that names it; None for other exposures."""
    seconds = exposure_us / _US_PER_S
    named = max(seconds, 1 / seconds)
    if not any(abs(named / name - 1) < _SAME_NAME for name in _SHUTTER_SPEEDS):
        return None
    step = 2 ** (round(3 * log2(seconds)) / 3)
    return step / seconds


def _exposure_us(frame: Photograph) -> float | None:
    stated = frame.facts.exposure_s
    return None if stated is None else round(stated * _US_PER_S, 3)


def _refuse_other_exposure(frame: Photograph, exposure_us: float | None, group: FrameGroup) -> None:
    known = group.exposure_us
    if exposure_us == known or (
        exposure_us and known and abs(exposure_us / known - 1) <= _SAME_EXPOSURE
    ):
        return
    one, other = (
        "of unknown exposure" if value is None else f"of {value:g} us"
        for value in (exposure_us, known)
    )
    raise NoiseError(
        f"{frame.name} is {one}, but other frames of {group.name} are {other}: a level has one "
        "exposure; put each exposure in a folder or list of its own",
        reason="settings",
    )


def _refuse_processed(frame: Photograph) -> None:
    """Refuse frames whose noise is not the sensor's."""
    why = ""
    if frame.is_jpeg:
        why = "a JPEG, whose compression changes the noise; save raw files, TIFF or PNG"
    elif not frame.encoding.is_linear:
        why = (
            f"{frame.encoding_sentence or frame.encoding.name}; noise is measured on linear levels"
        )
        why += ": save raw files or linear TIFF"
    elif frame.masked is not None:
        why = "some of its pixels are masked; give whole frames"
    elif frame.frames > 1:
        why = f"a mean of {frame.frames} frames; give the single frames"
    elif frame.is_colour and bool(np.any(np.ptp(frame.stored, axis=2))):
        why = "colours, which are interpolated between pixels; give raw files or grey frames"
    if why:
        raise NoiseError(f"{frame.name}: {why}", reason="settings")


@checked
def measure_noise(
    session: Session | FilePath | None = None,
    *,
    darks: Frames | None = None,
    flats: Frames | None = None,
    dark_exposures_us: Sequence[float] | None = None,
    flat_exposures_us: Sequence[float] | None = None,
    white_level: float | None = None,
    report: FilePath | None = None,
    reading: ReadOptions | None = None,
    progress: Progress | None = None,
) -> NoiseMeasurement:
    """Measure gain, read noise, black level, linearity and saturation, and map the sensor.

    Parameters
    ----------
    session
        A session, or its folder, with dark captures and a series of flats. Instead of it, frames
        can be given as ``darks`` and ``flats``.
    darks, flats
        Single frames, not means: at least two at each level, and flats at three levels or more. A
        level is a folder, a pattern such as ``"flats/*.tif"``, a file with a stack, an array
        ``(frames, rows, cols)``, or a list of frames. Several levels are a folder of folders, a
        list, an array of four axes, or a mapping, whose numeric keys are exposures in µs. Frames of
        one folder or list are sorted into levels by the exposures that their files state.
    dark_exposures_us, flat_exposures_us
        Exposure of each level in turn, in µs; by default that of the files (EXIF, FITS).
    white_level
        Level at which ``darks`` and ``flats`` are clipped; by default the files' own. Not for a
        session.
    report
        Path of a report to write as well, HTML or PDF.
    reading
        How ``darks`` and ``flats`` are read; see ``standoff.reading``. Not for a session.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    NoiseMeasurement
        The noise, and the dark, flat and defect maps; ``write_noise`` writes both. Remarks are in
        ``transfer.notes``.

    Raises
    ------
    ArgumentError
        If neither a session nor both darks and flats are given, or they hold no frames.
    NoiseError
        If captures are missing or were taken with different settings, or if frames are too few,
        differ in size, or do not hold a sensor's own levels (JPEG, sRGB-encoded, means).
    ImageFileError
        If a file cannot be read.

    Examples
    --------
    >>> noise = standoff.measure_noise("flats")
    >>> round(noise.transfer.gain_e_per_dn, 1)
    5.0

    From frames, here simulated with a gain of 4 e/DN and a read noise of 6 e:

    >>> import numpy as np
    >>> rng = np.random.default_rng(1)
    >>> def frames(electrons, count=8):
    ...     light = rng.poisson(electrons, (count, 60, 80)) + rng.normal(0, 6, (count, 60, 80))
    ...     return np.round(50 + light / 4).astype(np.uint16)
    >>> noise = standoff.measure_noise(
    ...     darks=frames(0),
    ...     flats={us: frames(2 * us) for us in (500, 1000, 2000, 3000)},
    ...     white_level=4095,
    ... )
    >>> print(f"{noise.transfer.gain_e_per_dn:.1f} e/DN, {noise.transfer.read_noise_e:.1f} e")
    4.0 e/DN, 6.0 e
    """
    page = None if report is None else output_path(report, "report", PAGES)
    require_writable([page])
    call = Call("measure_noise", progress, reading, white_level=white_level)
    if (session is None) == (darks is None and flats is None):
        raise ArgumentError("give a session, or darks and flats", argument="session")
    opened = None if session is None else opened_session(session)
    if opened is not None:
        _refuse_beside_session(
            dark_exposures_us=dark_exposures_us,
            flat_exposures_us=flat_exposures_us,
            white_level=white_level,
            reading=reading,
        )
        captures = NoiseCaptures.of_session(opened)
    elif darks is None or flats is None:
        raise ArgumentError(
            "both darks and flats are needed", argument="darks" if darks is None else "flats"
        )
    else:
        captures = _frame_captures(
            call,
            {"dark": darks, "flat": flats},
            {"dark": dark_exposures_us, "flat": flat_exposures_us},
        )
    with call.bar("reading captures", 2 * len(captures.captures)) as advance_to:
        found = noise_of_captures(captures, advance_to)
    origin = call.provenance() if opened is None else call.provenance_of(opened)
    found = found.with_provenance(origin)
    for text in found.transfer.notes:
        call.note(text)
    if page is not None:
        source = "Frames given" if opened is None else str(opened.path)
        write_page(page, noise_report(found, source).html())
    return found


def _refuse_beside_session(**given: object) -> None:
    for name, value in given.items():
        if value is not None:
            raise ArgumentError("is for darks and flats; a session states its own", argument=name)
