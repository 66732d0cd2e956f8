from .alignment_hints import (
    AlignmentHints as AlignmentHints,
    alignment_hints as alignment_hints,
    hint_files as hint_files,
    hint_settings as hint_settings,
)
from .change_search import (
    CHANGE_FILES as CHANGE_FILES,
    ComparedPhotographs as ComparedPhotographs,
    ComparisonRules as ComparisonRules,
    compared as compared,
    find_changes as find_changes,
    write_changes as write_changes,
)
from .limit_options import (
    DetectionLimitOptions as DetectionLimitOptions,
    scene_scale as scene_scale,
)
from .limit_prediction import expected_limit as expected_limit
from .registered import (
    FeatureMatches as FeatureMatches,
    RegistrationHints as RegistrationHints,
    register as register,
)
