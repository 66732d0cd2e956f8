"""What depends on nothing but two photographs, or a task, is found once by all commands."""

from collections.abc import Iterator

import pytest

from analysis.detectability import curves_of_images
from analysis.study import _change_errors as change_errors
from analysis.validation import _screening as screening
from calibration.errors import RegistrationError
from calibration.registration import register_images
from standoff.library.series import _pose_work as pose_work
from tests.standoff.asked_once import asked_once

_register_once = asked_once(register_images, RegistrationError)
_curves_once = asked_once(curves_of_images)


@pytest.fixture(scope="module", autouse=True)
def found_once() -> Iterator[None]:
    """Register two images once, and work out the curves of a task once."""
    with pytest.MonkeyPatch.context() as patched:
        for module in (pose_work, screening):
            patched.setattr(module, "register_images", _register_once)
        patched.setattr(change_errors, "curves_of_images", _curves_once)
        yield
