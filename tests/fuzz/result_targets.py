"""Files of results: psf.json, noise.json, geometry.json, H.json, curves, sweeps, photographs."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import tifffile
from hypothesis import strategies as st

from analysis.change_series import read_time_line
from analysis.changes._document import read_changes
from analysis.detectability._curves import read_curves
from analysis.errors import ResultsFileError
from analysis.pose._quality import read_pose
from analysis.sweep import Manifest, Records
from analysis.sweep._work import Writer
from analysis.validation._document import read_validation
from analysis.validation._kernels import KernelCache
from calibration.documents import json_object
from calibration.errors import GeometryFileError, HomographyFileError, NoiseFileError, PsfFileError
from calibration.files import read_correction, read_geometry, read_homography, read_noise, read_psf
from calibration.geometry._document import GEOMETRY_SCHEMA
from calibration.noise._document import NOISE_SCHEMA
from calibration.psf import psf_of_images
from calibration.registration._document import HOMOGRAPHY_SCHEMA
from simulation.kernelgan._estimate import KernelGanSettings
from standoff.errors import HintError
from standoff.library.registration import read_points
from tests.analysis.sweep.hashing import Hashing
from tests.calibration.edge_photographs import photographs
from tests.fuzz.damage import damaged_bytes, damaged_json
from tests.fuzz.target import FuzzTarget, from_file

Read = Callable[[Path], object]


@cache
def sound_psf() -> dict[str, Any]:
    """A measured psf.json; it is measured when it is first asked for. Do not write to it."""
    return json_object(psf_of_images(photographs([4.0, 94.0])))


def tiff(pixels: np.ndarray[Any, Any], **options: Any) -> bytes:
    buffer = BytesIO()
    tifffile.imwrite(buffer, pixels, **options)
    return buffer.getvalue()


NOISE: dict[str, Any] = {
    "schema": NOISE_SCHEMA,
    "gain_e_per_dn": 5.0,
    "read_noise_e": 12.0,
    "black_level_dn": 64.0,
    "frames_averaged": 10,
    "maps": {},
}
MAPS = {
    "noise-dark.tif": tiff(np.full((4, 5), 64, np.float32)),
    "noise-flat.tif": tiff(np.ones((4, 5), np.float32)),
    "noise-defects.tif": tiff(np.zeros((4, 5), np.uint8)),
}
LISTED = {
    name.partition("-")[2].removesuffix(".tif"): {
        "file": name,
        "sha256": hashlib.sha256(content).hexdigest(),
    }
    for name, content in MAPS.items()
}
GEOMETRY: dict[str, Any] = {
    "schema": GEOMETRY_SCHEMA,
    "heights_mm": [1.0, 2.0],
    "scale_px_per_mm": [3.0, 2.0],
    "pupil_offset_mm": 4.0,
    "k1": None,
    "k2": 0.1,
    "tilt_deg": 0.2,
    "axis_drift_px_per_mm": 0.3,
    "zooms": [{"near_height_mm": 1, "far_height_mm": 2, "zoom": 1.2, "zoom_err": 0.1}],
    "undetermined": {"k1": "why"},
}
HOMOGRAPHY: dict[str, Any] = {
    "schema": HOMOGRAPHY_SCHEMA,
    "matrix": [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]],
    "size": [30, 20],
    "distortion_k1": 0.01,
}
CURVES: dict[str, Any] = {
    "schema": "standoff.detectability/1",
    "curves": [
        {
            "model": "matched",
            "observer": "hotelling",
            "noise_dn": 2.0,
            "contrast_dn": 12.0,
            "signal_sigma_px": 2.0,
            "zoom": [1.0, 2.0],
            "dprime": [3.0, 2.0],
            "dprime_low": [2.0, 1.0],
            "dprime_high": [4.0, 3.0],
            "auc": [0.9, 0.8],
        }
    ],
}
CHANGES: dict[str, Any] = {
    "schema": "standoff.changes/1",
    "reference": "a.tif",
    "followup": "b.tif",
    "homography": [[1.5, 0.0, 2.0], [0.0, 1.5, 1.0], [0.0, 0.0, 1.0]],
    "distortion_k1": -0.01,
    "distortion_k1_err": None,
    "zoom": 1.5,
    "changed_px": 3,
    "compared_px": 4000,
    "threshold_sd": 4.5,
    "false_alarms_px": 0.05,
    "gain": 1.0,
    "extra_blur_px2": 0.01,
    "extra_blur_err_px2": None,
    "noise_factor": 1.0,
    "is_noise_known": True,
    "registration_err_px": 0.01,
    "width_err_px2": 0.02,
    "changes": [
        {
            "x_px": 3.0,
            "y_px": 4.0,
            "reference_x_px": 5.0,
            "reference_y_px": 6.0,
            "area_px": 7,
            "amplitude_dn": -8.0,
            "amplitude_err_dn": 1.0,
            "significance": 8.0,
            "q_value": 1e-6,
        }
    ],
    "saturated_px": 2,
    "kernel": "pair",
    "warnings": ["the texture repeats"],
}
TIME_LINE: dict[str, Any] = {
    "schema": "standoff.changes-series/1",
    "reference": "a.tif",
    "order": "time",
    "followups": [{"followup": "b.tif", "folder": "b", "taken": None, "changes": 1}],
    "tracks": [
        {
            "reference_x_px": 5.0,
            "reference_y_px": 6.0,
            "first_seen": 0,
            "last_seen": 0,
            "points": [{"sighting": "seen", "x_px": 3.0, "y_px": 4.0, "amplitude_dn": -8.0}],
        }
    ],
}
POSE: dict[str, Any] = {
    "is_accepted": True,
    "criterion": "min",
    "min_dprime": 2.0,
    "curve": {"model": "matched", "observer": "npw", "noise_dn": 2.0, "contrast_dn": 9.0},
    "dprime_decisive": 2.5,
    "dprime_min": 2.5,
    "dprime_max": 3.0,
    "zoom_min": 1.0,
    "zoom_max": 1.2,
    "anisotropy_max": 1.1,
    "overlap": 0.9,
    "beyond_curve": 0.0,
    "homography": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    "warnings": ["beware"],
}
POINTS = b"followup_x_px,followup_y_px,reference_x_px,reference_y_px\n" + b"".join(
    b"%d,%d,%d,%d\n" % (x, y, x + 3, y + 4) for x in (1, 9) for y in (2, 8)
)
VALIDATION: dict[str, Any] = {
    "schema": "standoff.validation/1",
    "session": "s",
    "psf": "psf.json",
    "psf_covariance_px2": [[0.5, 0.0], [0.0, 0.5]],
    "models": ["matched"],
    "references_per_target": 2,
    "training_steps": 4000,
    "training_seed": 0,
    "table_1": [],
    "table_2": [
        {
            "alignment": "followup-grid",
            "model": "matched",
            "correlation": 0.99,
            "mse_dn2": 1.5,
            "nmi": 1.6,
            "psnr_db": None,
            "psnr_of_mean_db": 46.0,
            "ssim": 0.99,
            "pairs": 3,
        }
    ],
    "pairs": [],
    "excluded": [{"capture": 2, "target": "leaves", "height_mm": 150.0, "reason": "shaken"}],
    "remarks": ["dim"],
}
LINES = (
    b'{"photographs": "%032x", "notes": {"a": "b"}, "files": {"c": 9}}\n{}\n' % 1,
    b'{"photographs": "%032x", "refused": "a: no image", "is_begun": true}\n{}\n' % 2,
)


def segment_of(*texts: bytes) -> bytes:
    """A segment with records of these lines, and three bytes each."""
    with TemporaryDirectory() as folder:
        [*_, last] = Writer(Path(folder)).append_texts([(text, b"123") for text in texts])
        return (Path(folder) / last.segment).read_bytes()


SEGMENT = segment_of(*LINES)
KERNEL_OF = np.zeros((4, 4), np.uint8)


def use_psf(path: Path) -> None:
    """Read, and ask for all that a simulation asks for."""
    psf = read_psf(path)
    psf.total_psf(str(path))
    psf.total_field(str(path))
    psf.measured_transfer(str(path))


def use_correction(path: Path) -> None:
    for name, content in MAPS.items():
        path.with_name(name).write_bytes(content)
    read_correction(path)


def damaged_map(data: bytes) -> object:
    """A map that is damaged, while its sum says it is what was written."""
    listed = LISTED | {
        "dark": {"file": "noise-dark.tif", "sha256": hashlib.sha256(data).hexdigest()}
    }
    document = json.dumps(NOISE | {"maps": listed}).encode()
    beside = tuple((MAPS | {"noise-dark.tif": data}).items())
    return from_file(read_correction, "noise.json", *beside)(document)


def read_segment(path: Path) -> object:
    with Manifest([path], path.parent) as manifest:
        return list(Records(manifest, Hashing(path.parent)).answers())


def read_kernel(data: bytes) -> object:
    settings = KernelGanSettings(zoom=2.0)

    def load(path: Path) -> object:
        cache = KernelCache(path.parent)
        path.rename(cache.path(KERNEL_OF, settings))
        return cache.load(KERNEL_OF, settings)

    return from_file(load, "kernel.npy")(data)


def npy(values: np.ndarray[Any, Any]) -> bytes:
    buffer = BytesIO()
    np.save(buffer, values)
    return buffer.getvalue()


def _json(document: dict[str, Any], name: str, read: Read, error: type[Exception]) -> FuzzTarget:
    return FuzzTarget(name, damaged_json(document), from_file(read, name), (error,))


_KERNEL = npy(np.full((13, 13), 1 / 169))
RESULT_TARGETS = (
    FuzzTarget(
        "psf.json",
        st.deferred(lambda: damaged_json(sound_psf())),
        from_file(use_psf, "psf.json"),
        (PsfFileError,),
        120,
    ),
    _json(NOISE, "noise.json", read_noise, NoiseFileError),
    replace(
        _json(NOISE | {"maps": LISTED}, "noise.json", use_correction, NoiseFileError),
        name="noise.json with maps",
    ),
    FuzzTarget(
        "map of a noise.json",
        damaged_bytes((MAPS["noise-dark.tif"],)),
        damaged_map,
        (NoiseFileError,),
        150,
    ),
    _json(GEOMETRY, "geometry.json", read_geometry, GeometryFileError),
    _json(HOMOGRAPHY, "H.json", read_homography, HomographyFileError),
    _json(CURVES, "curves.json", read_curves, ResultsFileError),
    _json(CHANGES, "changes.json", read_changes, ResultsFileError),
    _json(TIME_LINE, "series.json", read_time_line, ResultsFileError),
    _json(POSE, "pose.json", read_pose, ResultsFileError),
    FuzzTarget(
        "points.csv", damaged_bytes((POINTS,)), from_file(read_points, "points.csv"), (HintError,)
    ),
    _json(VALIDATION, "validation.json", read_validation, ResultsFileError),
    # What cannot be read is none: it is done again.
    FuzzTarget(
        "records of a sweep", damaged_bytes((SEGMENT,)), from_file(read_segment, "0.records"), ()
    ),
    FuzzTarget(
        "record of a sweep, whole but damaged before it was written",
        damaged_bytes(tuple(LINES)).map(segment_of),
        from_file(read_segment, "0.records"),
        (),
    ),
    FuzzTarget("cached kernel", damaged_bytes((_KERNEL,)), read_kernel, (ResultsFileError,)),
)
