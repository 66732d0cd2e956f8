"""The practice bench: the simulated GigE camera on a stage in real time."""

from collections.abc import Callable
from dataclasses import replace
from time import sleep
from types import TracebackType
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from acquisition.bench import BenchConfig
from hil_mocks.gige import ETHERNET_MTU_BYTES, BenchFrameSource, GigeDevice, Maker, maker_identity
from hil_mocks.scene import CameraPose
from hil_mocks.target_bench import TargetBench


class StageEmulator(Protocol):
    """What the practice bench needs of an emulated stage."""

    @property
    def port(self) -> str | None:
        """Path of its serial port; None if it has none."""
        ...

    @property
    def true_height_mm(self) -> float:
        """Present true height of the camera."""
        ...


class HandStage:
    """A stand without motor or port, moved by hand; it starts in the middle.

    Parameters
    ----------
    limits_mm
        Its lowest and highest height.
    """

    def __init__(self, limits_mm: tuple[float, float]) -> None:
        self._limits_mm = limits_mm
        self._height_mm = sum(limits_mm) / 2

    @property
    def port(self) -> str | None:
        """See `StageEmulator.port`."""
        return None

    @property
    def true_height_mm(self) -> float:
        """See `StageEmulator.true_height_mm`."""
        return self._height_mm

    def move_to(self, height_mm: float) -> None:
        """Move the stand.

        Raises
        ------
        ValueError
            If the height is outside its limits.
        """
        low, high = self._limits_mm
        if not low <= height_mm <= high:
            raise ValueError(f"the stand travels from {low:g} to {high:g} mm, not to {height_mm:g}")
        self._height_mm = height_mm


NEAREST_MM = 1.0
"""Smallest distance of the entrance pupil: a stage further down would touch the plane."""

HEIGHT_STEP_MM = 0.001
"""Heights are rounded to this: a smaller vibration does not cost one rendering per frame."""

STILL_S = 0.005
"""A stage whose height does not change for so long is at rest."""


class PracticeBench(TargetBench):
    """A GigE camera on a stage that looks down on a target, which an operator can exchange.

    At first the target is black and white paper with a horizontal edge. The first frame after
    the stage or the target has moved is late by its rendering time, but none of a stage at rest
    shows where it was on its way.

    Parameters
    ----------
    config
        A bench with a ``[simulated]`` section, which holds the truth.
    height_mm
        Returns the present true height of the stage.
    address
        Address of the camera, in 127.0.0.0/8.
    bayer_order
        Colour filter of the camera, such as ``RG``; None for a monochrome one.
    link_mtu_bytes
        Largest packet that the link to the camera carries.
    maker
        Whose cameras it is like, in the names, types and units of its features.

    Raises
    ------
    BenchConfigError
        If the bench has no ``[simulated]`` section, or an impossible one.
    ValueError
        If the address is not one of the loopback network.
    """

    def __init__(
        self,
        config: BenchConfig,
        *,
        height_mm: Callable[[], float],
        address: str = "127.0.0.1",
        bayer_order: str | None = None,
        link_mtu_bytes: int = ETHERNET_MTU_BYTES,
        maker: Maker = "allied_vision",
    ) -> None:
        super().__init__(config)
        self._height_mm = height_mm
        self._mounting = CameraPose(height_mm=0.0)
        self.source = BenchFrameSource(
            self.truth.sensor,
            self._look,
            seed=self.truth.settings.seed,
            bayer_order=bayer_order,
        )
        self.camera = GigeDevice(
            self.source,
            address=address,
            bayer_order=bayer_order,
            black_level_dn=self.truth.black_level_dn,
            link_mtu_bytes=link_mtu_bytes,
            identity=maker_identity(maker, address),
        )

    @property
    def pose(self) -> CameraPose:
        """True pose of the camera, its height rounded to a micrometre and above the plane."""
        height_mm = round(self._height_mm() / HEIGHT_STEP_MM) * HEIGHT_STEP_MM
        lowest_mm = NEAREST_MM - self.truth.camera.pupil_offset_mm
        return replace(self._mounting, height_mm=max(height_mm, lowest_mm))

    def _look(self) -> NDArray[np.float32]:
        """Present light on the sensor: another rendering if the stage came to rest meanwhile."""
        pose = self.pose
        view = super()._look()
        return view if self.pose == pose or self._is_moving() else super()._look()

    def _is_moving(self) -> bool:
        pose = self.pose
        sleep(STILL_S)
        return self.pose != pose

    def __enter__(self) -> Self:
        self.camera.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.camera.close()
