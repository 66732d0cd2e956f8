"""Photon transfer and correction maps from darks and flats, of a session or of one's own."""

from collections.abc import Sequence

from acquisition.photographs import ReadOptions
from acquisition.session import Session
from analysis.reports import render_noise_report
from calibration.files import write_noise as write_noise_file
from calibration.noise import (
    NoiseCalibration,
    NoiseCaptures,
    NoiseMeasurement,
    measure_noise as measured_noise,
)
from simulation.arguments import ArgumentError, checked
from standoff.library.call import Call, Progress
from standoff.library.files import PAGES, require_writable, write_page, written_together
from standoff.library.frame_groups import Frames, frame_captures
from standoff.library.inputs import FilePath, opened_session, output_path


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
        With dark captures and a series of flats; or give frames of your own as ``darks`` and
        ``flats``.
    darks, flats
        Single frames, two of a level at least, of flats at three levels at least. A level is a
        folder, a pattern such as ``"flats/*.tif"``, a file with a stack, an array ``(frames, rows,
        cols)``, or a list of frames. Several are a folder of folders, a list, an array of four
        axes, or a mapping of levels, whose numbers are exposures in µs; frames of one folder or
        list are told apart by the exposures that their files state.
    dark_exposures_us, flat_exposures_us
        Exposure of each level in turn; by default that of the files (EXIF, FITS).
    white_level
        Level at which the frames are clipped; by default the files' own. For frames alone.
    report
        Also write a report, HTML or PDF.
    reading
        How files are read; see ``standoff.reading``.
    progress
        Who watches.

    Returns
    -------
    NoiseMeasurement
        With the maps of dark, flat and defects; ``write_noise`` writes both. What there is to
        say of it stands in ``transfer.notes``.

    Raises
    ------
    ArgumentError
        If neither a session nor both darks and flats are given, or what is given holds no frames.
    NoiseError
        If captures are missing, or taken with different settings; if frames are too few, differ
        in size, or are no levels of a sensor (JPEG, encoded as sRGB, means).
    ImageFileError
        If a file cannot be read.

    Examples
    --------
    >>> noise = standoff.measure_noise("flats")
    >>> round(noise.transfer.gain_e_per_dn, 1)
    5.0

    Frames of one's own, here simulated with 4 e/DN and 6 e:

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
            "darks and flats are needed, both", argument="darks" if darks is None else "flats"
        )
    else:
        captures = frame_captures(
            call,
            {"dark": darks, "flat": flats},
            {"dark": dark_exposures_us, "flat": flat_exposures_us},
        )
    with call.bar("reading captures", 2 * len(captures.captures)) as advance_to:
        found = measured_noise(captures, advance_to)
    origin = call.provenance() if opened is None else call.provenance_of(opened)
    found = found.with_provenance(origin)
    for text in found.transfer.notes:
        call.note(text)
    if page is not None:
        source = "Frames given" if opened is None else str(opened.path)
        write_page(page, render_noise_report(found, source))
    return found


def _refuse_beside_session(**given: object) -> None:
    for name, value in given.items():
        if value is not None:
            raise ArgumentError("a session has its own; it is for darks and flats", argument=name)


@checked
def write_noise(path: FilePath, noise: NoiseMeasurement) -> NoiseCalibration:
    """Write noise.json and its maps beside it, all or none; return the document.

    Parameters
    ----------
    path
        Of noise.json.
    noise
        As ``measure_noise`` returns it.

    Returns
    -------
    NoiseCalibration
        The document, with the names of the maps.

    Raises
    ------
    NoiseFileError, ApplicationError
        If a file cannot be written.

    Examples
    --------
    >>> document = standoff.write_noise("flats.json", standoff.measure_noise("flats"))
    >>> round(document.read_noise_e)
    12
    """
    out = output_path(path, "path", {".json"})
    with written_together(out) as folder:
        return write_noise_file(folder / out.name, noise)
