from ._training import (
    TrainingOptions as TrainingOptions,
    TrainingPair as TrainingPair,
    train_detector as train_detector,
)
from ._weights import (
    LearnedDetector as LearnedDetector,
    load_learned as load_learned,
)
