"""What is wrong with a calibration is named, and nothing where nothing is.

Squares in closed form as in benchmarks/studies/psf_coverage.py, two captures of two squares at each
of five heights. Faults have the strength at which d' at zoom 1.5 moves by 5 %, of which a width has
to be off by 3 % there, and a distance by 1.5 %:

- soft target: a print whose blur adds 6 % to the variance, averaged over the heights;
- focus drift: a variance that changes along a line over the heights, 6 % up and down at the ends;
- focus scatter: captures scatter by 6 % of the variance;
- stage: the heights that were read scatter by 1.5 % of the distance;
- shape: a lens with a halo, a sum of two Gaussians, whose transfer is off by what 3 % of a width
  does, 0.016, somewhere up to three quarters of Nyquist beside the Gaussian that fits its edges.

    python -m benchmarks.studies.psf_misfits
"""

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.harness import Recorder, benchmark
from benchmarks.studies.psf_coverage import (
    HEIGHTS_MM,
    LENS_PX2,
    PUPIL_MM,
    PX_MM,
    SIDE_MM,
    SNRS,
    Shot,
    photographed,
)
from calibration.edges import EdgeImage
from calibration.psf import PsfCalibration, psf_of_images

TOTAL_PX2 = LENS_PX2 + 1 / 12
OFF_PX2 = 0.06 * TOTAL_PX2
OFF_DISTANCE = 0.015
HALO_SHARE, HALO_PX2 = 0.08, 1.6
PER_HEIGHT = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fault:
    """What is wrong, by its name in psf.json; every strength is 0 where nothing is."""

    name: str
    blur_px2: float = 0.0
    drift_px2: float = 0.0
    scatter_px2: float = 0.0
    stage: float = 0.0
    halo: float = 0.0


def _scale2(height_mm: float) -> float:
    """Square of the scale, over its mean over the heights."""
    scales = [(HEIGHTS_MM[0] + PUPIL_MM) / (h + PUPIL_MM) for h in (height_mm, *HEIGHTS_MM)]
    return scales[0] ** 2 / float(np.mean(np.square(scales[1:])))


FAULTS = (
    _Fault(name="soft_target", blur_px2=OFF_PX2),
    _Fault(name="focus_drift", drift_px2=OFF_PX2),
    _Fault(name="focus_drift", drift_px2=-OFF_PX2),
    _Fault(name="focus_scatter", scatter_px2=OFF_PX2),
    _Fault(name="stage", stage=OFF_DISTANCE),
    _Fault(name="shape", halo=HALO_SHARE),
)


def _shown(fault: _Fault, shot: Shot, rng: np.random.Generator) -> EdgeImage:
    """A capture; a halo is a second Gaussian that gets a share of the light."""
    if fault.halo == 0:
        return photographed(shot, rng)
    state = rng.bit_generator.state
    core = photographed(replace(shot, lens_px2=shot.lens_px2 * 0.85), rng)
    rng.bit_generator.state = state
    quiet = replace(shot, lens_px2=HALO_PX2)
    halo = photographed(quiet, rng)
    # The same squares and the same noise in both: noise is kept whole by adding both shares.
    image = (1 - fault.halo) * core.image_dn + fault.halo * halo.image_dn
    return replace(core, image_dn=image)


def _calibrated(fault: _Fault, snr: float, rng: np.random.Generator) -> PsfCalibration:
    """A calibration with a fault, over five heights."""
    low, high = HEIGHTS_MM[0], HEIGHTS_MM[-1]
    sources = []
    for k, height_mm in enumerate(np.repeat(HEIGHTS_MM, PER_HEIGHT).tolist()):
        away = 2 * (height_mm - low) / (high - low) - 1
        added = fault.blur_px2 * _scale2(height_mm) + fault.drift_px2 * away
        added += rng.normal(0.0, fault.scatter_px2)
        misread = rng.normal(0.0, fault.stage) * (height_mm + PUPIL_MM)
        shot = Shot(
            lens_px2=max(LENS_PX2 + added, 0.02),
            half_px=SIDE_MM / 2 * PX_MM / (height_mm + PUPIL_MM),
            snr=snr,
            capture=k,
            height_mm=height_mm + misread,
        )
        sources.append(_shown(fault, shot, rng))
    return psf_of_images(sources)


def _names_of(psf: PsfCalibration) -> set[str]:
    """What is named."""
    assert psf.cross_validation is not None
    return {one.kind for one in psf.cross_validation.named}


@benchmark("numpy", "scipy")
def main(record: Recorder) -> None:
    clean_draws, draws = record.pick(100, 2), record.pick(30, 2)
    for snr in SNRS:
        for fault, count in ((_Fault(name="clean"), clean_draws), *((f, draws) for f in FAULTS)):
            rng = np.random.default_rng([11, round(snr)])
            found = [_names_of(_calibrated(fault, snr, rng)) for _ in range(count)]
            listed = Counter(name for names in found for name in names)
            right = 100 * float(np.mean([fault.name in names for names in found]))
            some = 100 * float(np.mean([bool(names) for names in found]))
            text = ", ".join(f"{name} {n}" for name, n in listed.most_common())
            record.say(f"SNR {snr:3.0f}, {fault.name:13} of {count}: {text or 'nothing'}")
            if fault.name == "clean":
                record.figure(f"clean runs with a name, SNR {snr:.0f}", some, "%")
            else:
                record.figure(f"{fault.name} named, SNR {snr:.0f}", right, "%")
