"""What noise.json holds of a noise calibration."""

import hashlib
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from acquisition.session import atomic_write
from acquisition.untrusted import TiffDamageError, read_tiff
from calibration.errors import NoiseFileError
from calibration.noise.captures import NoiseCalibration
from calibration.noise.correction_maps import CorrectionMaps

__all__ = ["NOISE_SCHEMA", "map_paths", "noise_document", "read_map_files", "write_map_files"]

_NAMES = ("dark", "flat", "defects")
_TITLES = {
    "dark": "standoff noise: mean level without light, DN",
    "flat": "standoff noise: response relative to the mean of the sensor",
    "defects": "standoff noise: 1 dark, 2 response, 4 noise; 0 is sound",
}


def map_paths(path: Path) -> dict[str, Path]:
    """Where the maps of a noise.json lie: ``noise_dark.tif`` and so on, beside it."""
    return {name: path.with_name(f"{path.stem}_{name}.tif") for name in _NAMES}


def write_map_files(path: Path, maps: CorrectionMaps) -> dict[str, dict[str, str]]:
    """Write the maps beside the noise.json ``path``; return their names and hashes.

    Raises
    ------
    NoiseFileError
        If one cannot be written.
    """
    planes: dict[str, NDArray[Any]] = {
        "dark": maps.dark_dn,
        "flat": maps.response,
        "defects": maps.defects,
    }
    written = {}
    for name, place in map_paths(path).items():
        buffer = BytesIO()
        tifffile.imwrite(
            buffer,
            planes[name],
            photometric="minisblack",
            description=_TITLES[name],
            metadata=None,
        )
        data = buffer.getvalue()
        try:
            atomic_write(place, data)
        except OSError as error:
            raise NoiseFileError(f"cannot write {place}: {error.strerror}") from error
        written[name] = {"file": place.name, "sha256": hashlib.sha256(data).hexdigest()}
    return written


def read_map_files(path: Path, listed: object, black_level_dn: float) -> CorrectionMaps:
    """Read the maps that the noise.json ``path`` lists.

    Raises
    ------
    NoiseFileError
        If one is missing, is not the one that was written, or does not fit the others.
    """
    if not isinstance(listed, Mapping):
        raise NoiseFileError(
            f"{path}: lists no maps; write it with standoff noise from dark and flat captures"
        )
    planes = {name: _plane(path, name, listed.get(name)) for name in _NAMES}
    try:
        return CorrectionMaps(
            dark_dn=planes["dark"].astype(np.float32, copy=False),
            response=planes["flat"].astype(np.float32, copy=False),
            defects=planes["defects"].astype(np.uint8, copy=False),
            black_level_dn=black_level_dn,
        )
    except ValueError as error:
        raise NoiseFileError(f"{path}: {error}") from error


def _plane(path: Path, name: str, entry: object) -> NDArray[Any]:
    file = entry.get("file") if isinstance(entry, Mapping) else None
    if not isinstance(file, str) or not isinstance(entry, Mapping) or Path(file).name != file:
        raise NoiseFileError(f"{path}: maps.{name} names no file beside it")
    place = path.with_name(file)
    try:
        data = place.read_bytes()
    except OSError as error:
        raise NoiseFileError(
            f"cannot read {place}, a map of {path.name}: {error.strerror}; keep them together"
        ) from error
    if hashlib.sha256(data).hexdigest() != entry.get("sha256"):
        raise NoiseFileError(
            f"{place} is not the map that {path.name} was written with; run standoff noise again"
        )
    try:
        return read_tiff(data, first_alone=True).images[0]
    except TiffDamageError as error:
        raise NoiseFileError(f"{place}: not a readable TIFF file: {error}") from error


NOISE_SCHEMA = "standoff.noise/1"


def noise_document(noise: NoiseCalibration, maps: dict[str, dict[str, str]]) -> dict[str, Any]:
    """Return noise.json as a JSON object; ``_err`` are standard errors, unknown ones null.

    Parameters
    ----------
    noise
        The calibration.
    maps
        File name and sha256 of the dark, flat and defect maps beside noise.json.
    """
    transfer = noise.transfer
    dark, linearity = transfer.dark, transfer.linearity
    return {
        "schema": NOISE_SCHEMA,
        "gain_e_per_dn": transfer.gain_e_per_dn,
        "gain_e_per_dn_err": transfer.gain_e_per_dn_err,
        "read_noise_e": transfer.read_noise_e,
        "read_noise_e_err": transfer.read_noise_e_err,
        "black_level_dn": dark.black_level_dn,
        "black_level_dn_err": dark.black_level_dn_err,
        "saturation_dn": transfer.saturation.level_dn,
        "saturation_dn_err": transfer.saturation.err_dn,
        "saturation_is_reached": transfer.saturation.is_reached,
        "saturation_e": transfer.saturation_e,
        "frames_averaged": noise.frames_averaged,
        "linearity_error": None if linearity is None else linearity.mean_deviation,
        "linearity_worst": None if linearity is None else linearity.worst_deviation,
        "light_drift_per_s": None if linearity is None else linearity.light_drift_per_s,
        "light_flicker": transfer.light_flicker,
        "dark_current_e_per_s": dark.current_e_per_s,
        "dark_current_e_per_s_err": dark.current_e_per_s_err,
        "dsnu_e": noise.nonuniformity.dsnu_dn * transfer.gain_e_per_dn,
        "prnu": noise.nonuniformity.prnu,
        "shading": noise.nonuniformity.shading,
        "defect_pixels": noise.nonuniformity.defects,
        "fit_low_dn": transfer.fit_low_dn,
        "fit_high_dn": transfer.fit_high_dn,
        "chi2_reduced": transfer.chi2_reduced,
        "gain_db": noise.gain_db,
        "pixel_format": noise.pixel_format,
        "camera_serial": noise.camera_serial,
        "camera_model": noise.camera_model,
        "captured_utc": noise.captured_utc,
        "darks": noise.darks,
        "flats": noise.flats,
        "notes": list(transfer.notes),
        "maps": maps,
        "levels": [
            {
                "kind": sample.kind,
                "capture": sample.name,
                "exposure_us": sample.exposure_us,
                "mean_dn": sample.mean_dn,
                "variance_dn2": sample.variance_dn2,
                "pixels": sample.pixels,
                "frames": sample.frames,
                "clipped_fraction": sample.clipped_fraction,
                "is_fitted": is_fitted,
            }
            for sample, is_fitted in zip(transfer.samples, transfer.fitted, strict=True)
        ],
    }
