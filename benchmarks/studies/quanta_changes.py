"""What noise-equivalent quanta predict beside what ``changes`` finds, and false alarms without any.

Each of three cameras photographs a chart of edges, from which ``standoff lens`` states NEQ by
frequency, and a scene twice. Gaussian spots appear in the second photograph, as objects before lens
and pixel, at contrasts about the one that an ideal observer with that NEQ sees as often as not at
the threshold of the comparison. The share that ``changes`` lists is fitted by the distribution of
noise: where it is a half, the command's limit lies. Nothing of the prediction knows the renderer.

    python -m benchmarks.studies.quanta_changes
"""

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
from scipy.optimize import minimize
from scipy.special import ndtr

import standoff
from analysis.changes import ChangeOptions, ChangeSummary, changes_between
from benchmarks.harness import Recorder, benchmark
from benchmarks.truth.focus_scenes import FocusedLens, chart, squares
from benchmarks.truth.lenses import gaussian
from benchmarks.truth.pairs import Development, PairPose, pair_of, scene
from calibration.lens import CapacityFigures
from simulation.arrays import FloatArray

FRAME = (290, 390)
CAMERAS = ((0.6, 6.0), (0.8, 12.0), (1.0, 20.0))
"""Width of the Gaussian lens in px, noise in DN."""
SCENES = {"texture": 25.0, "lesion": 15.0, "mondrian": 45.0}
SPOTS_PX = (1.0, 2.0, 3.0)
FACTORS = (0.7, 1.4)
ACROSS, DOWN, MARGIN_PX, JITTER_PX = 4, 3, 45, 10.0
REACH_PX = 4.0
SEED = 2166
SAME = PairPose(zoom=1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Spot:
    """An object: its place, its width, and its contrast times the light."""

    x_px: float
    y_px: float
    sigma_px: float
    amplitude_dn: float

    def photograph(self, lens_px: float) -> FloatArray:
        """What it adds behind a Gaussian and square pixels, in closed form."""
        wide = sqrt(self.sigma_px**2 + lens_px**2)
        shares = [
            ndtr((np.arange(size) + 0.5 - at) / wide) - ndtr((np.arange(size) - 0.5 - at) / wide)
            for size, at in zip(FRAME, (self.y_px, self.x_px), strict=True)
        ]
        return np.asarray(self.amplitude_dn * 2 * pi * self.sigma_px**2 * np.outer(*shares))


def quanta_of(lens_px: float, noise_dn: float, rng: np.random.Generator) -> CapacityFigures:
    """NEQ as the lens report states it, of a chart of edges."""
    lens = FocusedLens(
        width_px=480, height_px=360, best_mm=0.0, sigma_px=lens_px, blur_px_per_mm=0.0,
        tangential_mm=0.0, sagittal_mm=0.0, tilt_x_mm=0.0, tilt_y_mm=0.0,
    )  # fmt: skip
    light = chart(lens, squares(lens, 4, 3), 32.0, 6.0, 0.0)
    found = standoff.measure_lens(light + rng.normal(0, noise_dn, light.shape)).capacity
    assert found is not None
    return found


def snr_of_spot(capacity: CapacityFigures, sigma_px: float, amplitude_dn: float) -> float:
    """SNR of an ideal observer between two photographs, from the table of NEQ by frequency.

    NEQ scales with the square of the light: the spot's amplitude over the level that it holds at.
    """
    freq, neq = np.array(capacity.freq_cy_per_px), np.array(capacity.neq)
    spectrum = 2 * pi * sigma_px**2 * np.exp(-2 * (pi * sigma_px * freq) ** 2)
    energy = 2 * pi * float(np.trapezoid(spectrum**2 * neq * freq, freq))
    return amplitude_dn / capacity.level_dn * sqrt(energy / 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """A spot: its predicted SNR over the threshold, and whether it was listed."""

    sigma_px: float
    height: float
    found: bool


@dataclass(kw_only=True)
class Camera:
    """One camera: its lens, noise, the quanta measured, and the threshold of its comparisons."""

    lens_px: float
    noise_dn: float
    quanta: CapacityFigures

    def pair(self, name: str, seed: int) -> tuple[FloatArray, FloatArray]:
        """Two photographs of a scene without noise."""
        blur = gaussian(self.lens_px, has_pixel=True)
        drawn = scene(name, FRAME, seed, contrast_dn=SCENES[name])
        made = pair_of(drawn, FRAME, SAME, (blur, blur))
        return made.reference_dn, made.followup_dn

    def compared(
        self, pair: tuple[FloatArray, FloatArray], added: FloatArray, seed: int
    ) -> ChangeSummary:
        """Compare them in noise, with something added to the second."""
        noise = Development(noise_dn=self.noise_dn)
        reference, followup = noise.of(pair[0], 2 * seed), noise.of(pair[1] + added, 2 * seed + 1)
        options = ChangeOptions(pose=SAME.known(FRAME))
        return changes_between(reference, followup, None, options).summary

    def judged(self, seed: int, rng: np.random.Generator) -> tuple[list[Judged], int]:
        """Spots of one comparison, and what is listed in the same pair without them."""
        name = list(SCENES)[seed % len(SCENES)]
        pair = self.pair(name, seed)
        plain = self.compared(pair, np.zeros(FRAME), 2 * seed)
        x, y = np.meshgrid(
            np.linspace(MARGIN_PX, FRAME[1] - MARGIN_PX, ACROSS),
            np.linspace(MARGIN_PX, FRAME[0] - MARGIN_PX, DOWN),
        )
        at = np.stack([x.ravel(), y.ravel()], axis=1)
        at += rng.uniform(-JITTER_PX, JITTER_PX, at.shape)
        spots, heights = [], []
        for (x_px, y_px), size in zip(
            at.tolist(), rng.permutation(np.resize(SPOTS_PX, len(at))).tolist(), strict=True
        ):
            factor = float(np.exp(rng.uniform(*np.log(FACTORS))))
            height = factor * plain.threshold_sd
            amplitude = height / snr_of_spot(self.quanta, size, 1.0) * float(rng.choice([-1, 1]))
            spots.append(Spot(x_px=x_px, y_px=y_px, sigma_px=size, amplitude_dn=amplitude))
            heights.append(factor)
        added = np.sum([one.photograph(self.lens_px) for one in spots], axis=0)
        listed = self.compared(pair, added, 2 * seed + 1).changes
        found = [
            any(
                np.hypot(one.x_px - spot.x_px, one.y_px - spot.y_px)
                < max(REACH_PX, 1.5 * spot.sigma_px)
                and one.amplitude_dn * spot.amplitude_dn > 0
                for one in listed
            )
            for spot in spots
        ]
        judged = [
            Judged(sigma_px=spot.sigma_px, height=height, found=one)
            for spot, height, one in zip(spots, heights, found, strict=True)
        ]
        return judged, len(plain.changes)


def half_power(judged: list[Judged]) -> tuple[float, float]:
    """Height at which a half is found, over the predicted one, and its standard error."""
    height, found = (
        np.array([one.height for one in judged]),
        np.array([one.found for one in judged]),
    )

    def surprise(p: FloatArray) -> float:
        share = np.clip(ndtr((height - p[0]) / np.exp(p[1])), 1e-6, 1 - 1e-6)
        return -float(np.sum(np.where(found, np.log(share), np.log1p(-share))))

    fit = minimize(surprise, np.array([1.0, np.log(0.2)]), method="Nelder-Mead").x
    share = ndtr((height - fit[0]) / np.exp(fit[1]))
    density = np.exp(-0.5 * ((height - fit[0]) / np.exp(fit[1])) ** 2) / sqrt(2 * pi)
    known = density**2 / np.maximum(share * (1 - share), 1e-9) / np.exp(2 * fit[1])
    return float(fit[0]), 1 / sqrt(float(np.sum(known)))


@benchmark("numpy", "scipy", "numba", note="zoom 1, pose given")
def main(record: Recorder) -> None:
    """Paint spots about the predicted limit, and count what is listed without any."""
    rng = np.random.default_rng(SEED)
    pooled: list[Judged] = []
    alarms = frames = 0
    for number, (lens_px, noise_dn) in enumerate(CAMERAS):
        quanta = quanta_of(lens_px, noise_dn, rng)
        camera = Camera(lens_px=lens_px, noise_dn=noise_dn, quanta=quanta)
        own: list[Judged] = []
        for turn in range(record.pick(10, 2)):
            judged, listed = camera.judged(1000 * number + turn, rng)
            own += judged
            alarms, frames = alarms + listed, frames + 1
        half, err = half_power(own)
        record.say(
            f"lens {lens_px:g} px, noise {noise_dn:g} DN: found as often as not at {half:.3f} "
            f"± {1.96 * err:.3f} of the predicted contrast, {len(own)} spots"
        )
        record.figure(f"limit found over predicted, lens {lens_px:g} px", half, "")
        pooled += own
    for size in SPOTS_PX:
        half, err = half_power([one for one in pooled if one.sigma_px == size])
        record.say(f"spots of {size:g} px: {half:.3f} ± {1.96 * err:.3f}")
        record.figure(f"limit found over predicted, spots of {size:g} px", half, "")
    half, err = half_power(pooled)
    record.say(f"all {len(pooled)} spots: {half:.3f} ± {1.96 * err:.3f}")
    record.figure("limit found over predicted", half, "")
    record.say(f"{alarms} changes listed in {frames} pairs without any")
    record.figure("changes listed a pair without any", alarms / frames, "")
