"""Translation of Aravis' errors into ours."""

from collections.abc import Iterator
from contextlib import contextmanager

from acquisition.aravis.library import AravisLibrary, AravisObject
from acquisition.errors import (
    CameraFeatureError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceInUseError,
    DeviceProtocolError,
    MissingFeatureError,
)


@contextmanager
def translated_errors(library: AravisLibrary, feature: str) -> Iterator[None]:
    """Turn an Aravis error inside the block into one of ours that names the feature."""
    try:
        yield
    except UnicodeDecodeError as error:
        raise DeviceProtocolError(f"what the camera says of {feature} is not text") from error
    except library.glib.Error as error:
        raise _device_error(library, feature, error) from error


def _device_error(library: AravisLibrary, feature: str, error: AravisObject) -> DeviceError:
    codes = library.api.DeviceError
    if _is_code(error, codes.NOT_CONTROLLER, codes.PROTOCOL_ERROR_ACCESS_DENIED):
        return DeviceInUseError(
            f"the camera denies access to {feature}; another program controls the camera, or it "
            "does not allow this at present"
        )
    if _is_code(
        error,
        codes.TIMEOUT,
        codes.NOT_CONNECTED,
        codes.NOT_FOUND,
        codes.TRANSFER_ERROR,
        codes.GENICAM_NOT_FOUND,
    ):
        return DeviceDisconnectedError(f"the camera does not answer ({feature}: {error.message})")
    if _is_code(error, codes.FEATURE_NOT_FOUND):
        return MissingFeatureError(f"the camera has no feature {feature}", names=(feature,))
    return CameraFeatureError(f"the camera refuses {feature}: {error.message}", feature=feature)


def _is_code(error: AravisObject, *codes: AravisObject) -> bool:
    is_device_error = error.domain == "arv-device-error-quark"
    return is_device_error and error.code in [int(code) for code in codes]
