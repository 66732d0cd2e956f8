"""What a caller may choose about a pose's simulation, beside the images, the warp and the PSF."""

from dataclasses import dataclass
from math import isfinite

from simulation.choices import DEFAULT_MODEL, POSE_MODELS, PoseModel
from simulation.pose.view import PoseView


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseOptions:
    """Model, noise, threads, and where the follow-up lies in the lens's frame.

    Parameters
    ----------
    model
        One of ``POSE_MODELS``.
    noise_ratio
        Variance of the reference's noise over that of the scene, for ``lmmse``.
    threads
        How many work at a time; the result is the same to the last bit.
    origin_px
        Position ``(x, y)`` of the follow-up's pixel (0, 0) in the camera's frame, if the
        follow-up is a part of that frame; by default it is the whole frame. It matters only for
        a PSF field and a distortion.
    distortion_k1
        Radial distortion of the lens that took both: an ideal point at the radius r from the
        reference's centre, 1 at its corner, is seen at ``r (1 + k1 r^2)``. The homography is then
        that of the ideal points.

    Raises
    ------
    ValueError
        If the model is unknown, the noise is negative, or there is no thread.
    """

    model: PoseModel = DEFAULT_MODEL
    noise_ratio: float = 0.0
    threads: int = 1
    origin_px: tuple[float, float] | None = None
    distortion_k1: float = 0.0

    def model_of(self, view: PoseView) -> PoseModel:
        """Return the model for a view: pixels that are the reference's own are not estimated.

        ``lmmse`` is the best on average over subpixel positions; at whole ones ``matched`` returns
        the reference.
        """
        return "matched" if view.is_by_whole_pixels else self.model

    def __post_init__(self) -> None:
        if self.model not in POSE_MODELS:
            raise ValueError(f"model must be one of {', '.join(POSE_MODELS)}, got {self.model!r}")
        if not (self.noise_ratio >= 0 and isfinite(self.noise_ratio)):
            raise ValueError(f"noise_ratio must not be negative, got {self.noise_ratio}")
        if self.threads < 1:
            raise ValueError(f"threads must be at least 1, got {self.threads}")


DEFAULT_OPTIONS = PoseOptions()
