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
class ChangeOptions:
    """Options for comparing two photographs.

    ``pose``: pose of the follow-up in the reference; None registers them, with the lens's
    distortion. ``hints``: what is known of the pose where none is given. ``noise``: noise of both
    captures; None fits it. ``false_alarms``: follow-up pixels flagged by chance, expected in a
    frame. ``false_discovery_rate``: share of false ones among the changes listed, which then
    decides instead; None for the rate of false alarms. ``spot_sigma_px``: width of the spots that
    the map of the detection limit is for, in follow-up pixels. ``limit_contrast_dn``: amplitude for
    which the detection limit says where it would have been found. ``expected``: limits that were
    predicted, to hold against the one that is shown. ``left_out, reference_left_out``: pixels of
    the follow-up and of the reference that do not count, in their shapes. ``white_level_dn``:
    levels at which the reference and the follow-up are clipped, where they are known; a plateau at
    the top counts anyway. ``variance_dn2``: variance of each pixel of the reference and the
    follow-up, where it is known, as of captures merged from several exposures; it comes before
    ``noise``. ``step_variance_dn2``: variance of each pixel of the reference and the follow-up by
    the steps of their files, where those are known; otherwise they are looked for among the levels.
    ``least_dn``: amplitude below which what is significant is counted and not listed; None for the
    step of the files, at each place. ``step_dn``: steps of the levels of reference and follow-up,
    at each pixel, where they are known. ``coded_alike``: gives reference and follow-up as they
    would be in files that are coded alike, for photographs whose pixels lie upon each other.
    ``colours``: of photographs in colour; without them the levels are compared alone.
    ``limit_rgb``: direction in linear levels of red, green and blue of the changes that the limit
    is for, the largest of them 1; of photographs in colour. ``count_moved``: whether what a shift
    explains is listed among the changes.
    """

    pose: DistortedPose | None = None
    hints: RegistrationHints | None = None
    noise: CaptureNoise | None = None
    false_alarms: float = FALSE_ALARMS
    false_discovery_rate: float | None = None
    spot_sigma_px: float = SPOT_SIGMA_PX
    limit_contrast_dn: float | None = None
    expected: "LimitCurve | None" = None
    left_out: BoolArray | None = None
    reference_left_out: BoolArray | None = None
    white_level_dn: tuple[float | None, float | None] = (None, None)
    variance_dn2: tuple[Float32Array | None, Float32Array | None] = (None, None)
    step_variance_dn2: tuple[Float32Array | None, Float32Array | None] = (None, None)
    least_dn: float | None = None
    step_dn: tuple[Float32Array | None, Float32Array | None] = (None, None)
    coded_alike: Callable[[], CodedAlike] | None = None
    colours: PairColours | None = None
    limit_rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)
    count_moved: bool = False
