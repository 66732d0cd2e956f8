from ._matching_kernel import (
    KERNEL_RADIUS_PX as KERNEL_RADIUS_PX,
    MatchingKernel as MatchingKernel,
    ToneCurve as ToneCurve,
    WhiteNoiseGain as WhiteNoiseGain,
    fit_tone_curve as fit_tone_curve,
    white_noise_gain as white_noise_gain,
)
from ._pair_fit import (
    SAMPLE_PX as SAMPLE_PX,
    FitRules as FitRules,
    FittedScatter as FittedScatter,
    PairFit as PairFit,
    PairModel as PairModel,
    fit_pair as fit_pair,
)
from ._smoothed_warp import (
    PixelPositions as PixelPositions,
    Window as Window,
    away_from as away_from,
    rounding_variance as rounding_variance,
    sampled as sampled,
    smoothed as smoothed,
    spline_coefficients as spline_coefficients,
)
from ._variance import (
    GRADIENT as GRADIENT,
    LAPLACIAN as LAPLACIAN,
    VarianceTerms as VarianceTerms,
    calibrated_factor as calibrated_factor,
)
from .relative_blur import (
    RelativeBlur as RelativeBlur,
    Smoothing as Smoothing,
    calibrated_blur_px2 as calibrated_blur_px2,
    relative_blur as relative_blur,
    smoothing_for as smoothing_for,
)
