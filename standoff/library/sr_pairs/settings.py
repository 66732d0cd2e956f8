"""What all pairs of a dataset have in common, and which split an image belongs to."""

import hashlib
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, get_args

from numpy.typing import NDArray

from simulation import Model, Psf, PsfField
from standoff.library.sr_pairs.choices import PairFormat
from standoff.photographs import ReadOptions

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
    """

    zoom: float
    model: Model
    psf: Psf
    crop_px: int
    stride_px: int
    test_fraction: float
    seed: int
    is_float: bool
    field: PsfField | None = None
    threads: int = 1
    format: PairFormat = "folder"

    def psf_of(self, image: NDArray[Any]) -> Psf | PsfField:
        """Return the field for a whole frame of the camera, one PSF for any other image."""
        field = self.field
        if field is None or image.shape[:2] != (field.height_px, field.width_px):
            return self.psf
        return field

    def document(self, reading: ReadOptions) -> dict[str, Any]:
        """Return the settings, and how the images are read, as plain numbers."""
        encoding = reading.encoding
        own = asdict(replace(self, field=None))
        del own["field"], own["threads"]
        if self.field is not None:
            own["psf_field"] = {
                "size": [self.field.width_px, self.field.height_px],
                "coefficients_px2": self.field.coefficients_px2.tolist(),
            }
        return {
            "schema": DATASET_SCHEMA,
            **own,
            "reading": {
                "encoding": "auto" if encoding is None else encoding.name,
                "page": reading.page,
                "is_mean": reading.is_mean,
            },
        }


def split_of(digest: str, settings: SrDatasetSettings) -> Split:
    """Split of an image, from its content, so that adding images does not move others."""
    draw = hashlib.sha256(f"{settings.seed}:{digest}".encode()).digest()
    share = int.from_bytes(draw[:8], "big") / 2**64
    return "test" if share < settings.test_fraction else "train"
