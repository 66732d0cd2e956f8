from .alignment import Procedure as Procedure, scaled_up as scaled_up
from .kernel_cache import (
    CACHE_VARIABLE as CACHE_VARIABLE,
    KernelCache as KernelCache,
    default_cache_folder as default_cache_folder,
)
from .kernels import (
    PAPER_TRAINING_STEPS as PAPER_TRAINING_STEPS,
    KernelBook as KernelBook,
    trainings_needed as trainings_needed,
)
from .metrics import ImageMetrics as ImageMetrics, compare_images as compare_images
from .models import (
    VALIDATION_MODELS as VALIDATION_MODELS,
    ValidationModel as ValidationModel,
    is_learned as is_learned,
)
from .pair import PairValidation as PairValidation
from .processing import (
    FULL_SCALE_DN as FULL_SCALE_DN,
    process_for_comparison as process_for_comparison,
)
from .screening import registrations_at_most as registrations_at_most, screen as screen
from .session import (
    METRICS as METRICS,
    Validation as Validation,
    table_2 as table_2,
    validate as validate,
)
from .tables import (
    TABLE_NOTES as TABLE_NOTES,
    ResultTable as ResultTable,
    both_tables as both_tables,
    curves_csv as curves_csv,
    validation_document as validation_document,
)

__all__ = [
    "CACHE_VARIABLE",
    "FULL_SCALE_DN",
    "METRICS",
    "PAPER_TRAINING_STEPS",
    "TABLE_NOTES",
    "VALIDATION_MODELS",
    "ImageMetrics",
    "KernelBook",
    "KernelCache",
    "PairValidation",
    "Procedure",
    "ResultTable",
    "Validation",
    "ValidationModel",
    "both_tables",
    "compare_images",
    "curves_csv",
    "default_cache_folder",
    "is_learned",
    "process_for_comparison",
    "registrations_at_most",
    "scaled_up",
    "screen",
    "table_2",
    "trainings_needed",
    "validate",
    "validation_document",
]
