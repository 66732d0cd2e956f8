"""Switch off whatever makes levels non-linear, replaces pixels or changes settings by itself."""

from dataclasses import dataclass, field

from acquisition.aravis.feature_names import FeatureName, neutral_features
from acquisition.aravis.features import CameraFeatures, FeatureValue
from acquisition.errors import CameraFeatureError, DeviceError, DeviceInUseError


@dataclass(slots=True)
class NeutralFeatures:
    """The features of the table that a camera has, as read back, and what it kept."""

    values: dict[str, FeatureValue] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def neutralise(features: CameraFeatures, camera: str) -> NeutralFeatures:
    """Give every feature of the table that the camera has its neutral value.

    A feature behind a selector gets it for each entry; ``NAME[ENTRY]`` is then its key.

    Parameters
    ----------
    features
        The camera's features.
    camera
        Vendor and model, as the camera names them.

    Raises
    ------
    CameraFeatureError
        If the camera keeps a value that would falsify levels; the error names the feature.
    """
    result = NeutralFeatures()
    switched_off: set[str] = set()
    for row in neutral_features(camera):
        if not features.has(row.name):
            continue
        if not row.selector or not features.has(row.selector):
            _neutralise_one(features, row, row.name, result, switched_off)
            continue
        entries = features.entries(row.selector)
        for entry in entries:
            key = row.name if len(entries) == 1 else f"{row.name}[{entry}]"
            with features.selected(row.selector, entry):
                if features.has(row.name):
                    _neutralise_one(features, row, key, result, switched_off)
    return result


def _neutralise_one(
    features: CameraFeatures,
    row: FeatureName,
    key: str,
    result: NeutralFeatures,
    switched_off: set[str],
) -> None:
    neutral = _neutral_value(features, row)
    refusal: DeviceError | None = None
    if neutral is not None:
        try:
            features.write(row.name, neutral)
        except (CameraFeatureError, DeviceInUseError) as error:
            refusal = error
    if neutral is None or refusal is not None:
        result.values[key] = kept = features.read(row.name)
        is_a_number = features.type_of(row.name) in ("integer", "float")
        if is_a_number and row.purpose in switched_off:
            return  # a strength without effect, as its switch is off
        told = " or ".join(row.neutral)
        if row.if_kept == "refuse":
            raise CameraFeatureError(
                f"the camera keeps {key} at {kept} instead of {told}, and levels would not be "
                f"those of the sensor ({row.purpose}); set it to {told} with the maker's program",
                feature=row.name,
            ) from refusal
        result.warnings.append(
            f"the camera keeps {key} at {kept} instead of {told} ({row.purpose}); this is recorded"
        )
        return
    result.values[key] = features.read(row.name)
    if features.type_of(row.name) in ("boolean", "enumeration"):
        switched_off.add(row.purpose)


def _neutral_value(features: CameraFeatures, row: FeatureName) -> FeatureValue | None:
    """The neutral value in the type that the feature has in this camera; None if it has none."""
    kind = features.type_of(row.name)
    if kind == "enumeration":
        entries = features.entries(row.name)
        return next((name for name in row.neutral if name in entries), None)
    if kind == "boolean":
        return {"true": True, "false": False}.get(row.neutral[0])
    if row.neutral == ("min",):
        low = features.bounds(row.name).low
        return round(low) if kind == "integer" else low
    number = next((float(text) for text in row.neutral if text.lstrip("-").isdigit()), None)
    if number is None:
        return None
    return round(number) if kind == "integer" else number
