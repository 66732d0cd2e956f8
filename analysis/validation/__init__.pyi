from .alignment import Procedure as Procedure, scaled_up as scaled_up
from .document import (
    METRICS as METRICS,
    ValidatedPair as ValidatedPair,
    Validation as Validation,
    read_validation as read_validation,
)
from .kernel_cache import KernelCache as KernelCache, default_cache_folder as default_cache_folder
from .kernels import KernelBook as KernelBook, trainings_needed as trainings_needed
from .metrics import ImageMetrics as ImageMetrics, compare_images as compare_images
from .models import is_learned as is_learned
from .processing import (
    FULL_SCALE_DN as FULL_SCALE_DN,
    process_for_comparison as process_for_comparison,
)
from .screening import (
    NothingToCompareError as NothingToCompareError,
    registrations_at_most as registrations_at_most,
    screen as screen,
)
from .session import (
    ValidationSettings as ValidationSettings,
    mean_metrics as mean_metrics,
    validate as validate,
)
from .shown import (
    ShownPair as ShownPair,
    drawn_procedure as drawn_procedure,
    furthest_pair as furthest_pair,
    shown_pairs as shown_pairs,
)
from .tables import (
    TABLE_NOTES as TABLE_NOTES,
    ResultTable as ResultTable,
    both_tables as both_tables,
    curves_csv as curves_csv,
)
