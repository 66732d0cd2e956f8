"""A detector that learns from change pairs, as the public interface offers it."""

from analysis.detectors.learned import (
    LearnedDetector as LearnedDetector,
    TrainingOptions as TrainingOptions,
    train_detector as train_detector,
)
