from .alignment_hints import (
    AlignmentHints as AlignmentHints,
    alignment_hints as alignment_hints,
    hint_files as hint_files,
    hint_settings as hint_settings,
)
from .change_search import (
    CHANGE_FILES as CHANGE_FILES,
    ComparedPhotographs as ComparedPhotographs,
    ComparisonKeywords as ComparisonKeywords,
    ComparisonRules as ComparisonRules,
    begun_comparison as begun_comparison,
    compared as compared,
    find_changes as find_changes,
    write_changes as write_changes,
)
from .limit_options import (
    DetectionLimitOptions as DetectionLimitOptions,
    limit_files as limit_files,
)
from .registered import (
    FeatureMatches as FeatureMatches,
    RegistrationHints as RegistrationHints,
    register as register,
)
