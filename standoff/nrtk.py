"""The capture model as a perturber of NRTK: photographs as the same camera takes them further away.

Imports nothing of NRTK. Its sweeps, and whatever else calls a perturber, take an object with these
methods; where ``nrtk.interfaces`` has been imported, it is an instance of ``PerturbImage`` as well.
To load one from NRTK's configuration files, derive from both, ours first.
"""

import sys
import zlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.photographs import Encoding
from simulation.arrays import FloatArray
from simulation.choices import DEFAULT_MODEL, Model
from standoff.errors import ArgumentError
from standoff.library import (
    CaptureOptions,
    NoiseLike,
    PsfLike,
    camera_noise,
    opened_psf,
    simulate,
)

Boxes = Iterable[tuple[Any, Mapping[Any, float]]]
"""Boxes with the scores of each; a box has ``min_vertex`` and ``max_vertex``, (x, y) each."""


class FollowupPerturber:
    """Shows a photograph as the same camera would take it from further away.

    The image becomes smaller by the zoom, as it does in the camera; boxes go with it.

    Parameters
    ----------
    psf
        Total PSF of the camera, or its psf.json.
    zoom
        Ratio of the distances, at least 1.
    noise
        Of the camera, or its noise.json: of the photographs that are given and of those that are
        returned. None adds none.
    model
        Of the capture; as in ``standoff.simulate``.
    encoding
        How levels follow from light: ``srgb`` as in most files, ``linear`` or ``gamma:G``.
    seed
        Of the noise, which also depends on the image: two have not the same, and one has always.

    Raises
    ------
    ArgumentError
        If the zoom is not at least 1, or there is no such encoding.

    Examples
    --------
    >>> from standoff.nrtk import FollowupPerturber
    >>> image = standoff.read_image("before.tif").grey_dn
    >>> perturber = FollowupPerturber("psf.json", zoom=1.5, noise="noise.json")
    >>> smaller, boxes = perturber(image=image, boxes=None)
    >>> smaller.shape, boxes
    ((160, 213), None)
    """

    def __init__(
        self,
        psf: PsfLike,
        zoom: float,
        noise: NoiseLike | None = None,
        *,
        model: Model = DEFAULT_MODEL,
        encoding: str = "srgb",
        seed: int = 0,
    ) -> None:
        if not 1 <= zoom < np.inf:
            raise ArgumentError(f"zoom: expected a number from 1 on, got {zoom:g}")
        try:
            self._encoding = Encoding(name=encoding)
        except ValueError as error:
            raise ArgumentError(f"encoding: {error}") from error
        self._config: dict[str, Any] = {
            "psf": psf,
            "zoom": zoom,
            "noise": noise,
            "model": model,
            "encoding": encoding,
            "seed": seed,
        }
        self._psf = opened_psf(psf)
        self._noise = camera_noise(noise)
        _be_a_perturb_image(type(self))

    def perturb(
        self,
        image: NDArray[Any],
        boxes: Boxes | None = None,
        **_: object,
    ) -> tuple[NDArray[Any], Boxes | None]:
        """Return the photograph from further away, and the boxes in it.

        Parameters
        ----------
        image
            Shape ``(rows, cols)`` or ``(rows, cols, channels)``; of integers, whose largest value
            is white, or of floats, whose white is 1.
        boxes
            Their vertices count from the outer corner of the first pixel.

        Returns
        -------
        image, boxes
            The image of the same type, ``floor(rows / zoom)`` by ``floor(cols / zoom)``; new boxes
            of the type of those that were given, with copies of their scores.

        Raises
        ------
        ApplicationError
            If it is no finite image, or too small for the zoom.
        """
        is_integer = np.issubdtype(image.dtype, np.integer)
        white_dn = float(np.iinfo(image.dtype).max) if is_integer else 1.0
        made = simulate(
            self._encoding.decode(image, white_dn),
            zoom=self._config["zoom"],
            psf=self._psf,
            model=self._config["model"],
            noise=self._noise,
            camera=CaptureOptions(seed=self._seed_of(image)),
        )
        levels = self._encoding.encode(np.clip(made.image, 0, None), white_dn)
        if is_integer:
            levels = np.rint(np.clip(levels, 0, white_dn))
        seen = None if boxes is None else self._moved(boxes, image.shape, levels.shape)
        return levels.astype(image.dtype), seen

    def __call__(
        self, image: NDArray[Any], boxes: Boxes | None = None, **more: object
    ) -> tuple[NDArray[Any], Boxes | None]:
        """Do as ``perturb``."""
        return self.perturb(image=image, boxes=boxes, **more)

    def get_config(self) -> dict[str, Any]:
        """Return the arguments that it was made with."""
        return dict(self._config)

    def _seed_of(self, image: NDArray[Any]) -> int:
        content = zlib.crc32(np.ascontiguousarray(image).tobytes())
        return int(np.random.SeedSequence([self._config["seed"], content]).generate_state(1)[0])

    def _moved(
        self, boxes: Boxes, before: tuple[int, ...], after: tuple[int, ...]
    ) -> list[tuple[Any, dict[Any, float]]]:
        """Boxes where the follow-up shows them: both frames have one centre."""
        sizes = [np.array([shape[1], shape[0]]) for shape in (before, after)]

        def seen(vertex: Iterable[float]) -> tuple[float, ...]:
            at: FloatArray = np.asarray(tuple(vertex), dtype=np.float64)
            return tuple(((at - sizes[0] / 2) / self._config["zoom"] + sizes[1] / 2).tolist())

        return [
            (
                type(box)(min_vertex=seen(box.min_vertex), max_vertex=seen(box.max_vertex)),
                dict(scores),
            )
            for box, scores in boxes
        ]


def _be_a_perturb_image(own: type) -> None:
    """Let ``isinstance`` know, if NRTK is in use."""
    interfaces = sys.modules.get("nrtk.interfaces")
    base = None if interfaces is None else getattr(interfaces, "PerturbImage", None)
    if base is not None and not issubclass(own, base):
        base.register(own)
