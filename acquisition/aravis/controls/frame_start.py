"""What starts a frame: the camera's own frame rate, a software trigger or a line."""

from acquisition.aravis.feature_names import names_for
from acquisition.aravis.features import Bounds, CameraFeatures, FeatureValue
from acquisition.errors import CameraFeatureError

FRAME_TRIGGERS = ("FrameStart", "ExposureStart", "FrameTrigger", "AcquisitionStart")
"""Entry of TriggerSelector that takes one frame, the first of these."""

EDGES = {"rising": "RisingEdge", "falling": "FallingEdge"}


class FrameRate:
    """The frame rate of one camera.

    Parameters
    ----------
    features
        The camera's features.
    camera
        Vendor and model, as the camera names them.
    asked_hz
        Frame rate of the bench file: what is reported of a camera that has no such feature.
    """

    def __init__(self, features: CameraFeatures, camera: str, asked_hz: float) -> None:
        self._features = features
        self._camera = camera
        self._asked_hz = asked_hz

    def hz(self) -> float:
        """Present frame rate, which long exposures lower."""
        name = self._name("frame rate")
        set_hz = self._asked_hz if name is None else self._features.number(name)
        return min(set_hz, self._limit_hz(), self._resulting_hz())

    def bounds_hz(self) -> Bounds:
        """Frame rates at the present exposure, region, packet size and bandwidth."""
        name = self._name("frame rate")
        if name is None:
            return Bounds(low=0.0, high=min(self._limit_hz(), self._resulting_hz()))
        bounds = self._features.bounds(name)
        return Bounds(low=bounds.low, high=min(bounds.high, self._limit_hz()))

    def set(self) -> tuple[str, ...]:
        """Set the frame rate of the bench file, or the highest possible; return warnings."""
        name = self._name("frame rate")
        if name is None:
            return (
                "the camera has no frame rate to set; camera.frame_rate_hz "
                f"{self._asked_hz:g} is only what the time limits go by",
            )
        wanted_hz = min(self._asked_hz, self.bounds_hz().high)
        self._features.send(name, wanted_hz)
        found_hz = self._features.number(name)
        if not abs(found_hz - wanted_hz) <= 0.01 * wanted_hz:
            raise CameraFeatureError(
                f"the camera does not keep {name}: set to {wanted_hz:g}, it reads {found_hz:g}",
                feature=name,
            )
        if self.hz() >= 0.999 * self._asked_hz:
            return ()
        return (
            f"camera.frame_rate_hz {self._asked_hz:g} is beyond what the camera can do at this "
            f"exposure, region and packet size; it runs at {self.hz():.2f}",
        )

    def restore(self) -> float:
        """Return to the frame rate of the bench file, as far as the exposure allows; in Hz."""
        if self.hz() < 0.99 * min(self._asked_hz, self.bounds_hz().high):
            self.set()
        return self.hz()

    def _limit_hz(self) -> float:
        name = self._name("frame rate limit")
        return float("inf") if name is None else self._features.number(name)

    def _resulting_hz(self) -> float:
        name = self._name("resulting frame rate")
        return float("inf") if name is None else self._features.number(name) or float("inf")

    def _name(self, purpose: str) -> str | None:
        return self._features.first_of([row.name for row in names_for(purpose, self._camera)])


def set_trigger(features: CameraFeatures, source: str, edge: str) -> dict[str, FeatureValue]:
    """Let each frame wait for a trigger, and return what was set, as read back.

    Parameters
    ----------
    features
        The camera's features; its triggers are off.
    source
        ``software``, or the name of a line, such as ``Line1``.
    edge
        ``rising`` or ``falling``, of a line.

    Raises
    ------
    CameraFeatureError
        If the camera has no such trigger; the error lists those that it has.
    """
    for name in ("TriggerMode", "TriggerSource"):
        if not features.has(name):
            raise CameraFeatureError(
                f'camera.trigger {source!r}: the camera has no {name}; set camera.trigger to "off"',
                feature=name,
            )
    wanted: dict[str, FeatureValue] = {}
    if features.has("TriggerSelector"):
        entries = features.entries("TriggerSelector")
        selector = next((name for name in FRAME_TRIGGERS if name in entries), None)
        if selector is not None:
            wanted["TriggerSelector"] = selector
            features.write("TriggerSelector", selector)
    sources = {entry.casefold(): entry for entry in features.entries("TriggerSource")}
    if source.casefold() not in sources:
        raise CameraFeatureError(
            f"camera.trigger {source!r}: this camera is triggered by "
            f"{', '.join(sources.values()) or 'nothing'}",
            feature="TriggerSource",
        )
    wanted["TriggerSource"] = sources[source.casefold()]
    if source.casefold() != "software" and features.has("TriggerActivation"):
        wanted["TriggerActivation"] = EDGES[edge]
    wanted["TriggerMode"] = "On"
    for name, value in wanted.items():
        features.write(name, value)
    return {name: features.read(name) for name in wanted}
