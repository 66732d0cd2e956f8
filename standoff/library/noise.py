"""Photon transfer and correction maps from the dark and flat captures of a session."""

from acquisition.session import Session
from analysis.reports import render_noise_report
from calibration.files import write_noise as write_noise_file
from calibration.noise import (
    NoiseCalibration,
    NoiseMeasurement,
    measure_noise as measured_noise,
    noise_records,
)
from simulation.arguments import checked
from standoff.library.call import Call, Progress
from standoff.library.files import require_writable, write_page, written_together
from standoff.library.inputs import FilePath, opened_session, path_of


@checked
def measure_noise(
    session: Session | FilePath,
    *,
    report: FilePath | None = None,
    progress: Progress | None = None,
) -> NoiseMeasurement:
    """Measure gain, read noise, black level, linearity and saturation, and map the sensor.

    Parameters
    ----------
    session
        With dark captures and a series of flats.
    report
        Also write a report, HTML or PDF.
    progress
        Who watches.

    Returns
    -------
    NoiseMeasurement
        With the maps of dark, flat and defects; ``write_noise`` writes both. What there is to
        say of it stands in ``transfer.notes``.

    Raises
    ------
    NoiseError
        If captures are missing, or taken with different settings.

    Examples
    --------
    >>> noise = standoff.measure_noise("flats")
    >>> round(noise.transfer.gain_e_per_dn, 1)
    5.0
    """
    call = Call("measure_noise", progress)
    opened = opened_session(session)
    with call.bar("reading captures", 2 * len(noise_records(opened))) as advance_to:
        found = measured_noise(opened, advance_to)
    found = found.with_provenance(call.provenance_of(opened))
    for text in found.transfer.notes:
        call.note(text)
    if report is not None:
        page = path_of(report, "report")
        require_writable([page])
        write_page(page, render_noise_report(found, str(opened.path)))
    return found


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
    out = path_of(path, "path")
    with written_together(out) as folder:
        return write_noise_file(folder / out.name, noise)
