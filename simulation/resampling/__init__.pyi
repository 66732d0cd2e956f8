from .banded import (
    BandedMatrix as BandedMatrix,
    apply_separable as apply_separable,
    put_separable as put_separable,
)
from .cubic import (
    antialiased_cubic as antialiased_cubic,
    blur as blur,
    blur_at as blur_at,
    mirrored_rows as mirrored_rows,
    spline_sampling as spline_sampling,
)
from .gaussian_kernel import (
    BlurCovariance as BlurCovariance,
    SeparableTerm as SeparableTerm,
    gaussian_terms as gaussian_terms,
    matched_terms as matched_terms,
    spline_transfer as spline_transfer,
)
from .grid import ZOOM_MIN as ZOOM_MIN, SamplingGrid as SamplingGrid
from .reference_image import (
    reference_shape as reference_shape,
    refuse_non_finite as refuse_non_finite,
)
from .scattered import simulate_at as simulate_at
