"""The PSF that ``standoff guide`` measures on a phone's own frames, beside the one it was given.

Frames of known width (`Wall.through`: a Gaussian in light, on a grid four times as fine) are shown
to the guide as a phone shows them: held still further away, then held still at the reference, with
the quality that the page sends for this. Each width is to be within twice its standard error. A
camera that is blurred all the way is to be called good nowhere.

    python -m benchmarks.studies.guided_psf [--seed 1] [--quick]
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.harness import Recorder, benchmark
from benchmarks.studies.guided_hand import (
    FOCAL_PER_SIDE,
    FRAME,
    SCENES,
    reference_of,
    scene_levels,
)
from benchmarks.truth.hand_held import HeldPose, Wall
from standoff.console.guide import Assessment, GuideReference, Judge, LiveGuidance

SIGMAS_PX = (0.6, 1.0, 2.0)
DISTANCES = (1.25, 1.5)
BLURRED_PX = 3.0
PERIOD_S = 0.2
LONGEST_S = 300.0
_FINE = [cv2.IMWRITE_JPEG_QUALITY, 97]


def away(distance: float, rng: np.random.Generator) -> HeldPose:
    """A pose this many times as far, a little aside and turned."""
    axes = Rotation.from_euler("xyz", rng.uniform(-1, 1, 3) * [4, 4, 8], degrees=True)
    aside = rng.uniform(-0.04, 0.04, 2)
    return HeldPose(centre=np.array([*aside, 1 - distance]), axes=axes.as_matrix())


def fine_frame(levels: NDArray[np.uint8]) -> bytes:
    """A frame as the page sends it to tell how sharp the camera is."""
    return cv2.imencode(".jpg", levels, _FINE)[1].tobytes()


class Shown:
    """A phone that holds still before the guide, time after time."""

    def __init__(self, reference: GuideReference) -> None:
        self._now_s = 0.0
        self.live = LiveGuidance(Judge(reference), clock=lambda: self._now_s)
        self.greens = 0

    def hold(self, frame: bytes, times: int = 3) -> None:
        """Show one frame a few times, and wait for what is measured on it."""
        for _ in range(times):
            self.look(frame, is_fine=True)
        self.live.wait(LONGEST_S)

    def look(self, frame: bytes, *, is_fine: bool = False) -> Assessment:
        """Show one frame after the time between two."""
        self._now_s += PERIOD_S
        found = self.live.look(frame, is_fine=is_fine)
        self.greens += found.verdict == "go"
        return found


@benchmark("numpy", "scipy", "opencv-contrib-python-headless")
def main(record: Recorder, *, seed: Annotated[int, "of poses and noise"] = 1) -> None:
    """Measure known widths, and show a blurred camera."""
    names = SCENES[: record.pick(6, 2)]
    sigmas, distances = (record.pick(all_, all_[:1]) for all_ in (SIGMAS_PX, DISTANCES))
    off: list[float] = []
    relative: list[float] = []
    took: list[float] = []
    singles = missing = greens = shown = 0
    record.say(f"  {'scene':10} true σ  distance   found σ, px        words")
    with TemporaryDirectory() as folder:
        for number, name in enumerate(names):
            rng = np.random.default_rng([seed, number])
            wall = Wall.of(scene_levels(name), FRAME, FOCAL_PER_SIDE)
            reference = reference_of(wall, Path(folder) / f"{name}.jpg", rng)
            for sigma in sigmas:
                near = fine_frame(wall.through(HeldPose(), sigma, rng))
                for distance in distances:
                    phone = Shown(reference)
                    begin_s = time.process_time()
                    phone.hold(fine_frame(wall.through(away(distance, rng), sigma, rng)))
                    phone.hold(near)
                    took.append(time.process_time() - begin_s)
                    found = phone.live.frame_curve_of("")
                    if found is None:
                        missing += 1
                        record.say(f"  {name:10} {sigma:5.1f} {distance:8.2f}   none")
                        continue
                    singles += found.ratio is None
                    off.append((found.sigma_px - sigma) / found.sigma_err_px)
                    relative.append(found.sigma_px / sigma - 1)
                    how = "two distances" if found.ratio else "edges"
                    record.say(
                        f"  {name:10} {sigma:5.1f} {distance:8.2f}   {found.sigma_px:.2f} ± "
                        f"{found.sigma_err_px:.2f}   {off[-1]:+5.1f} errors  {how}"
                    )
            blurred = Shown(reference)
            for distance in (*distances, 1.0):
                pose = HeldPose() if distance == 1.0 else away(distance, rng)
                blurred.hold(fine_frame(wall.through(pose, BLURRED_PX, rng)))
                shown += 3
            blurred.hold(fine_frame(wall.through(HeldPose(), BLURRED_PX, rng)))
            greens += blurred.greens
            shown += 3
    within = sum(abs(one) <= 2 for one in off)
    record.say(
        f"\n{within} of {len(off)} within twice the standard error; {singles} by edges, {missing} "
        f"without a PSF; {greens} good verdicts on {shown} blurred frames"
    )
    record.figure("within twice the standard error", within, f"of {len(off)}")
    record.figure("relative error, median", 100 * float(np.median(relative)), "%")
    record.figure("relative error, largest", 100 * float(np.max(np.abs(relative))), "%")
    record.figure("by edges", singles, "")
    record.figure("without a PSF", missing, "")
    record.figure("good verdicts on blurred frames", greens, f"of {shown}")
    record.figure("processor time, median", float(np.median(took)), "s")
