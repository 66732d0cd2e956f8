from .lens import DISTORTION_MAX as DISTORTION_MAX
from .noise import pose_noise_gain as pose_noise_gain

__all__ = [
    "DISTORTION_MAX",
    "pose_noise_gain",
]
