"""A reference that several follow-ups are aligned with."""

from dataclasses import dataclass, field
from typing import Self

from calibration.registration.dense import AlignedPhotograph
from calibration.registration.features import ImageFeatures, features_of
from simulation.arrays import AnyArray, BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationReference:
    """A photograph prepared for alignment: its features are looked for once, and no sooner.

    `register` takes it in place of the array, which may not change meanwhile.
    """

    photograph: AlignedPhotograph
    _features: dict[bool, ImageFeatures] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, image: AnyArray, left_out: BoolArray | None = None) -> Self:
        """Take a grey image, shape ``(rows, cols)``; what is ``left_out`` does not count.

        Raises
        ------
        ValueError
            If it is not a grey image with finite values, or ``left_out`` has another shape.
        """
        return cls(AlignedPhotograph.of(image, left_out))

    def features(self, *, is_closer_look: bool) -> ImageFeatures:
        """Features of the photograph, as `features_of` finds them."""
        if is_closer_look not in self._features:
            self._features[is_closer_look] = features_of(
                self.photograph.levels, self.photograph.usable, is_closer_look=is_closer_look
            )
        return self._features[is_closer_look]
