"""The practice bench: the simulated GigE camera on a stage in real time, and its commands."""

from collections.abc import Callable
from dataclasses import replace
from math import isfinite
from time import sleep
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from acquisition.bench import BenchConfig
from hil_mocks.bench import TargetBench
from hil_mocks.gige import (
    ETHERNET_MTU_BYTES,
    BenchFrameSource,
    GigeDevice,
    GigeFaults,
    Maker,
    maker_identity,
)
from hil_mocks.truth import CameraPose


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
    """A stand without motor or port, moved by hand; it starts in the middle."""

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
        """Move the stand; ValueError if the height is outside its limits."""
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

    At first the target is black and white paper with a horizontal edge. The first frame after the
    stage or the target has moved is late by its rendering time, but none of a stage at rest shows
    where it was on its way. ``height_mm`` returns the present true height; ``address`` is the
    camera's in 127.0.0.0/8; ``bayer_order`` its colour filter, such as ``RG``; ``maker`` whose
    cameras it is like. BenchConfigError if the bench has no ``[simulated]`` section, or a wrong
    one.
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

    def __exit__(self, *_: object) -> None:
        self.camera.close()


TRUTH_VALUES = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}


class PracticeCommandError(Exception):
    """The practice bench does not understand a line; nothing was done.

    ``word`` is the part of the line that is wrong.
    """

    def __init__(self, text: str, word: str) -> None:
        super().__init__(text)
        self.word = word


class PracticeConsole:
    """Executes one line at a time on a practice bench."""

    def __init__(self, bench: PracticeBench, stage: StageEmulator) -> None:
        self._bench = bench
        self._stage = stage
        self._commands: dict[str, Callable[[list[str]], str]] = {
            "place": self._place,
            "height": self._height,
            "fault": self._fault,
            "restart": self._restart,
            "drop-control": self._drop_control,
            "status": self._status,
        }

    def execute(self, line: str) -> str:
        """Execute a line and return what was done; PracticeCommandError if it is not understood."""
        name, *words = line.split()
        command = self._commands.get(name)
        if command is None:
            raise PracticeCommandError(
                f"unknown command {name}; the commands are {', '.join(self._commands)}", name
            )
        return command(words)

    def _place(self, words: list[str]) -> str:
        if not 1 <= len(words) <= 2:
            raise PracticeCommandError("expected: place TARGET [DEGREES]", "place")
        orientation_deg = _number(words[1]) if len(words) == 2 else 0.0
        try:
            self._bench.place(words[0], orientation_deg)
        except ValueError as error:
            at_fault = words[0] if isfinite(orientation_deg) else words[1]
            raise PracticeCommandError(str(error), at_fault) from error
        return self._status([])

    def _height(self, words: list[str]) -> str:
        if len(words) != 1:
            raise PracticeCommandError("expected: height MM", "height")
        if not isinstance(self._stage, HandStage):
            raise PracticeCommandError(
                "the stage of this bench is moved through its serial port", "height"
            )
        try:
            self._stage.move_to(_number(words[0]))
        except ValueError as error:
            raise PracticeCommandError(str(error), words[0]) from error
        return self._status([])

    def _fault(self, words: list[str]) -> str:
        if words == ["none"]:
            self._bench.camera.faults = GigeFaults()
        else:
            self._bench.camera.faults = faults_from_words(self._bench.camera.faults, words)
        return self._status([])

    def _restart(self, _: list[str]) -> str:
        self._bench.camera.restart()
        return "the camera was restarted"

    def _drop_control(self, _: list[str]) -> str:
        self._bench.camera.drop_control()
        return "the camera is not under anyone's control"

    def _status(self, _: list[str]) -> str:
        bench = self._bench
        on = [
            f"{name}={getattr(bench.camera.faults, name)}"
            for name in GigeFaults.names()
            if getattr(bench.camera.faults, name) != getattr(GigeFaults(), name)
        ]
        return (
            f"target {bench.target} at {bench.orientation_deg:g} degrees, "
            f"height {self._stage.true_height_mm:.3f} mm, faults: {', '.join(on) or 'none'}"
        )


def faults_from_words(faults: GigeFaults, words: list[str]) -> GigeFaults:
    """Return the faults with new values: ``packet_loss_rate=0.01 is_stalled=true``.

    PracticeCommandError if there is no such fault or its value is invalid.
    """
    if not words:
        raise PracticeCommandError(
            f"expected: fault NAME=VALUE ... or fault none; "
            f"faults are {', '.join(GigeFaults.names())}",
            "fault",
        )
    for word in words:
        name, equals, text = word.partition("=")
        if name not in GigeFaults.names() or not equals:
            raise PracticeCommandError(
                f"{word}: expected NAME=VALUE; faults are {', '.join(GigeFaults.names())}", word
            )
        try:
            value = _value(name, text, getattr(faults, name))
            faults = replace(faults, **{name: value})  # type: ignore[arg-type]  # of the default's type
        except ValueError as error:
            raise PracticeCommandError(str(error), word) from error
    return faults


def _value(name: str, text: str, like: object) -> bool | int | float | frozenset[str]:
    if isinstance(like, bool):
        if text.lower() not in TRUTH_VALUES:
            raise ValueError(f"{name} must be true or false, got {text}")
        return TRUTH_VALUES[text.lower()]
    if isinstance(like, frozenset):
        return frozenset(part for part in text.split(",") if part)
    value = _number(text)
    if isinstance(like, int):
        if not value.is_integer():
            raise ValueError(f"{name} must be a whole number, got {text}")
        return int(value)
    return value


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise PracticeCommandError(f"not a number: {text}", text) from error
