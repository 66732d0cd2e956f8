"""How two photographs are compared."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from analysis.changes.colour import PairColours
from analysis.choices import FALSE_ALARMS, SPOT_SIGMA_PX
from calibration.registration import DistortedPose, RegistrationHints
from simulation.arrays import AnyArray, BoolArray, Float32Array
from simulation.capture_noise import CaptureNoise

if TYPE_CHECKING:
    from analysis.changes.prediction import LimitCurve


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CodedAlike:
    """Reference and follow-up, grey, as files that are coded alike hold them; and their colours."""

    photographs: tuple[AnyArray, AnyArray]
    colours: PairColours | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ChangeCriteria:
    """What counts as a change, as whoever compares decides.

    It is carried as a whole from the caller to the comparison, and is part of what a series does.

    Parameters
    ----------
    false_alarms
        Follow-up pixels flagged by chance, expected in a frame.
    false_discovery_rate
        Share of false ones among the changes listed, which then decides instead; None for the
        rate of false alarms.
    least_dn
        Amplitude below which what is significant is counted and not listed; None for the step of
        the files, at each place.
    count_moved
        Whether what a shift explains is listed among the changes.
    """

    false_alarms: float = FALSE_ALARMS
    false_discovery_rate: float | None = None
    least_dn: float | None = None
    count_moved: bool = False


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ChangeOptions(ChangeCriteria):
    """Options for comparing two photographs, besides what counts as a change.

    Parameters
    ----------
    pose
        Pose of the follow-up in the reference; None registers them, with the lens's distortion.
    hints
        What is known of the pose where none is given.
    noise
        Noise of both captures; None fits it.
    spot_sigma_px
        Width of the spots that the map of the detection limit is for, in follow-up pixels.
    limit_contrast_dn
        Amplitude for which the detection limit says where it would have been found.
    expected
        Limits that were predicted, to hold against the one that is shown.
    left_out, reference_left_out
        Pixels of the follow-up and of the reference that do not count, in their shapes.
    white_level_dn
        Levels at which the reference and the follow-up are clipped, where they are known; a
        plateau at the top counts anyway.
    variance_dn2
        Variance of each pixel of the reference and the follow-up, where it is known, as of captures
        merged from several exposures; it comes before ``noise``.
    step_variance_dn2
        Variance of each pixel of the reference and the follow-up by the steps of their files, where
        those are known; otherwise they are looked for among the levels.
    step_dn
        Steps of the levels of reference and follow-up, at each pixel, where they are known.
    coded_alike
        Gives reference and follow-up as they would be in files that are coded alike, for
        photographs whose pixels lie upon each other.
    colours
        Of photographs in colour; without them the levels are compared alone.
    limit_rgb
        Direction in linear levels of red, green and blue of the changes that the limit is for, the
        largest of them 1; of photographs in colour.
    """

    pose: DistortedPose | None = None
    hints: RegistrationHints | None = None
    noise: CaptureNoise | None = None
    spot_sigma_px: float = SPOT_SIGMA_PX
    limit_contrast_dn: float | None = None
    expected: "LimitCurve | None" = None
    left_out: BoolArray | None = None
    reference_left_out: BoolArray | None = None
    white_level_dn: tuple[float | None, float | None] = (None, None)
    variance_dn2: tuple[Float32Array | None, Float32Array | None] = (None, None)
    step_variance_dn2: tuple[Float32Array | None, Float32Array | None] = (None, None)
    step_dn: tuple[Float32Array | None, Float32Array | None] = (None, None)
    coded_alike: Callable[[], CodedAlike] | None = None
    colours: PairColours | None = None
    limit_rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)
