"""Two photographs are registered once, however many commands ask about them."""

import pickle
from collections.abc import Iterator
from functools import cache
from typing import Any

import pytest

from analysis.validation import _screening as screening
from calibration.errors import RegistrationError
from calibration.registration import Registration, register_images
from standoff.library.series import _pose_work as pose_work


@cache
def _found(asked: bytes) -> Registration | RegistrationError:
    arguments, options = pickle.loads(asked)
    try:
        return register_images(*arguments, **options)
    except RegistrationError as error:
        return error


def _register_once(*arguments: Any, **options: Any) -> Registration:
    found = _found(pickle.dumps((arguments, options)))
    if isinstance(found, RegistrationError):
        raise found
    return found


@pytest.fixture(scope="module", autouse=True)
def registered_once() -> Iterator[None]:
    """Keep what was found of two images, or that nothing was: it depends on nothing else."""
    with pytest.MonkeyPatch.context() as patched:
        for module in (pose_work, screening):
            patched.setattr(module, "register_images", _register_once)
        yield
