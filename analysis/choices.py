"""Choices for callers of this package: names and default values, without any library."""

from typing import Literal, get_args

from simulation.choices import KernelModel, Model

Observer = Literal["npw", "hotelling", "cho", "changes"]
OBSERVERS: tuple[Observer, ...] = ("npw", "hotelling", "cho")
"""Non-prewhitening, Hotelling and channelised Hotelling observer: templates on the difference that
an alignment leaves. What a comparison finds is told by ``changes``, if it is asked for."""

ALL_OBSERVERS: tuple[Observer, ...] = get_args(Observer)

CurveObserver = Literal[Observer, "detector"]
"""Who a curve is of: an observer, or somebody's own detector."""

REFERENCE_ZOOM = 2.0
"""Zoom from c to the reference c', from the paper."""

WINDOW_PX = 33
"""Side of the window on c'. A larger one finds more: docs/theory-detectability.md says how much."""

Criterion = Literal["min", "quantile"]
"""How a pose is judged: d' reaches the threshold everywhere, or in 95 % of the overlap."""

FALSE_ALARMS = 0.05
"""Expected number of pixels flagged in a frame without any change."""

SPOT_SIGMA_PX = 1.5
"""Width of the spots that the map of a comparison's detection limit is for."""

ValidationModel = Literal[Model, KernelModel]
VALIDATION_MODELS: tuple[ValidationModel, ...] = (
    "bicubic",
    "kernelgan",
    "gaussian-kernelgan",
    "paper",
    "matched",
    "lmmse",
)
"""All models, in the order of the paper's tables; later models at the end."""

PAPER_TRAINING_STEPS = 4000
"""Steps of every training, from the paper on camera poses."""

CACHE_VARIABLE = "STANDOFF_KERNEL_CACHE"
"""Environment variable that names the folder of trained kernels."""

PairFormat = Literal["folder", "webdataset"]
"""Two image files for each pair in folders, or tar files of the pairs of many photographs."""

ChangeSigns = Literal["both", "brighter", "darker"]
"""Whether changes of training pairs are brighter than the scene, darker, or either."""

BenchmarkSize = Literal["tiny", "small", "full"]
"""Of the public benchmark's data set: a few MB, about 100 MB, about 1 GB."""


def acceptance(is_accepted: bool) -> str:
    """Return the verdict on a pose by its threshold in a word, as everything that shows it does."""
    return "accepted" if is_accepted else "rejected"
