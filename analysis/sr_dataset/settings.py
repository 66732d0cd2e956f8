"""What all pairs of a dataset have in common, and which split an image belongs to."""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, get_args

from numpy.typing import NDArray

from analysis.choices import PairFormat
from simulation import Model, Psf, PsfField

DATASET_SCHEMA = "standoff.sr-pairs/1"

Split = Literal["train", "test"]
SPLITS: tuple[Split, ...] = get_args(Split)


@dataclass(frozen=True, slots=True, kw_only=True)
class SrDatasetSettings:
    """Settings common to all pairs of a dataset.

    ``test_fraction`` of the *images*, chosen by content and ``seed``, is the test split: crops
    of one image are never in both splits. With ``is_float`` both images are float32 TIFFs;
    otherwise low resolution is rounded to the type of the photograph and both are PNGs. A crop of
    an image of the size of ``field`` gets the PSF of its position. ``threads`` changes no pixel.
    ``reading`` says how the photographs are read, as plain values.
    """

    zoom: float
    model: Model
    psf: Psf
    crop_px: int
    stride_px: int
    test_fraction: float
    seed: int
    is_float: bool
    reading: Mapping[str, Any]
    field: PsfField | None = None
    threads: int = 1
    format: PairFormat = "folder"

    def psf_of(self, image: NDArray[Any]) -> Psf | PsfField:
        """Return the field for a whole frame of the camera, one PSF for any other image."""
        field = self.field
        if field is None or image.shape[:2] != (field.height_px, field.width_px):
            return self.psf
        return field

    def document(self) -> dict[str, Any]:
        """Return the settings as plain numbers."""
        own = asdict(replace(self, field=None))
        del own["field"], own["threads"], own["reading"]
        if self.field is not None:
            own["psf_field"] = {
                "size": [self.field.width_px, self.field.height_px],
                "coefficients_px2": self.field.coefficients_px2.tolist(),
            }
        return {"schema": DATASET_SCHEMA, **own, "reading": dict(self.reading)}


def split_of(digest: str, seed: int, test_fraction: float) -> Split:
    """Split of an image, from its content, so that adding images does not move others."""
    draw = hashlib.sha256(f"{seed}:{digest}".encode()).digest()
    share = int.from_bytes(draw[:8], "big") / 2**64
    return "test" if share < test_fraction else "train"
