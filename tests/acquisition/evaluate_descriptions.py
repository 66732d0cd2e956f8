"""Opens cameras and evaluates their features in a process that a test can see dying.

For each line on its standard input, a JSON list of a camera's address and names of features, it
writes one with the kind of the error, or an empty string.
"""

import json
import sys
from collections.abc import Callable
from contextlib import suppress

from acquisition.aravis._camera import AravisCamera
from acquisition.aravis._device import OpenedDevice, load_aravis, open_device
from acquisition.errors import DeviceError
from tests.acquisition.aravis_bench import camera_config

GETTERS = (
    "get_integer",
    "get_integer_bounds",
    "get_integer_increment",
    "get_float",
    "get_float_bounds",
    "get_string",
    "is_feature_available",
    "is_feature_implemented",
    "dup_available_enumerations_as_strings",
)


def evaluate(opened: OpenedDevice, feature: str) -> None:
    """Ask for all that Aravis knows of a feature, and write to it."""
    glib_error = load_aravis().glib.Error
    attempts: list[Callable[[], object]] = [
        *(lambda name=name: getattr(opened.camera, name)(feature) for name in GETTERS),
        lambda: opened.camera.set_integer(feature, 1),
        lambda: opened.device.get_feature(feature).get_selected_features(),
        lambda: opened.device.get_feature(feature).get_features(),
    ]
    for attempt in attempts:
        with suppress(glib_error, AttributeError):
            attempt()


def tried(address: str, features: list[str]) -> str:
    try:
        if not features:
            AravisCamera.open(camera_config(address)).close()
            return ""
        opened = open_device(address)
        try:
            for feature in features:
                evaluate(opened, feature)
        finally:
            opened.close()
    except DeviceError as error:
        return type(error).__name__
    return ""


if __name__ == "__main__":
    for line in sys.stdin:
        address, *features = json.loads(line)
        print(json.dumps(tried(address, features)), flush=True)  # noqa: T201  # what the test reads
