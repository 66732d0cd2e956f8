from ._document import (
    METRICS as METRICS,
    TABLE_NOTES as TABLE_NOTES,
    ResultTable as ResultTable,
    ValidatedPair as ValidatedPair,
    Validation as Validation,
    both_tables as both_tables,
    curves_csv as curves_csv,
    read_validation as read_validation,
)
from ._kernels import (
    KernelBook as KernelBook,
    KernelCache as KernelCache,
    default_cache_folder as default_cache_folder,
    is_learned as is_learned,
    trainings_needed as trainings_needed,
)
from ._metrics import (
    FULL_SCALE_DN as FULL_SCALE_DN,
    ImageMetrics as ImageMetrics,
    Procedure as Procedure,
    compare_images as compare_images,
    process_for_comparison as process_for_comparison,
    scaled_up as scaled_up,
)
from ._screening import (
    NothingToCompareError as NothingToCompareError,
    registrations_at_most as registrations_at_most,
    screen as screen,
)
from ._session import (
    ShownPair as ShownPair,
    ValidationSettings as ValidationSettings,
    drawn_procedure as drawn_procedure,
    furthest_pair as furthest_pair,
    mean_metrics as mean_metrics,
    shown_pairs as shown_pairs,
    validated as validated,
)
