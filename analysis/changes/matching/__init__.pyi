from .calibrated_blur import calibrated_blur_px2 as calibrated_blur_px2
from .fitted_scatter import FittedScatter as FittedScatter
from .matching_kernel import (
    KERNEL_RADIUS_PX as KERNEL_RADIUS_PX,
    MatchingKernel as MatchingKernel,
    WhiteNoiseGain as WhiteNoiseGain,
    white_noise_gain as white_noise_gain,
)
from .pair_fit import (
    SAMPLE_PX as SAMPLE_PX,
    FitRules as FitRules,
    PairFit as PairFit,
    fit_pair as fit_pair,
)
from .pair_model import PairModel as PairModel
from .pixels import (
    away_from as away_from,
    sampled as sampled,
)
from .relative_blur import (
    RelativeBlur as RelativeBlur,
    Smoothing as Smoothing,
    relative_blur as relative_blur,
    smoothing_for as smoothing_for,
)
from .residual_variance import (
    GRADIENT as GRADIENT,
    LAPLACIAN as LAPLACIAN,
    VarianceTerms as VarianceTerms,
)
from .rounding import rounding_variance as rounding_variance
from .smoothed_warp import (
    PixelPositions as PixelPositions,
    Window as Window,
    smoothed as smoothed,
    spline_coefficients as spline_coefficients,
)
from .tone_curve import (
    ToneCurve as ToneCurve,
    fit_tone_curve as fit_tone_curve,
)
from .variance_calibration import calibrated_factor as calibrated_factor
