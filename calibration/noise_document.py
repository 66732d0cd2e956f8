"""What noise.json holds of a noise calibration."""

from typing import Any

from calibration.noise_captures import NoiseCalibration

__all__ = ["NOISE_SCHEMA", "noise_document"]

NOISE_SCHEMA = "standoff.noise/1"


def noise_document(noise: NoiseCalibration, maps: dict[str, dict[str, str]]) -> dict[str, Any]:
    """Return noise.json as a JSON object; ``_err`` are standard errors, unknown ones null.

    Parameters
    ----------
    noise
        The calibration.
    maps
        File name and sha256 of the dark, flat and defect maps beside noise.json.
    """
    transfer = noise.transfer
    dark, linearity = transfer.dark, transfer.linearity
    return {
        "schema": NOISE_SCHEMA,
        "gain_e_per_dn": transfer.gain_e_per_dn,
        "gain_e_per_dn_err": transfer.gain_e_per_dn_err,
        "read_noise_e": transfer.read_noise_e,
        "read_noise_e_err": transfer.read_noise_e_err,
        "black_level_dn": dark.black_level_dn,
        "black_level_dn_err": dark.black_level_dn_err,
        "saturation_dn": transfer.saturation.level_dn,
        "saturation_dn_err": transfer.saturation.err_dn,
        "saturation_is_reached": transfer.saturation.is_reached,
        "saturation_e": transfer.saturation_e,
        "frames_averaged": noise.frames_averaged,
        "linearity_error": None if linearity is None else linearity.mean_deviation,
        "linearity_worst": None if linearity is None else linearity.worst_deviation,
        "light_drift_per_s": None if linearity is None else linearity.light_drift_per_s,
        "light_flicker": transfer.light_flicker,
        "dark_current_e_per_s": dark.current_e_per_s,
        "dark_current_e_per_s_err": dark.current_e_per_s_err,
        "dsnu_e": noise.nonuniformity.dsnu_dn * transfer.gain_e_per_dn,
        "prnu": noise.nonuniformity.prnu,
        "shading": noise.nonuniformity.shading,
        "defect_pixels": noise.nonuniformity.defects,
        "fit_low_dn": transfer.fit_low_dn,
        "fit_high_dn": transfer.fit_high_dn,
        "chi2_reduced": transfer.chi2_reduced,
        "gain_db": noise.gain_db,
        "pixel_format": noise.pixel_format,
        "camera_serial": noise.camera_serial,
        "camera_model": noise.camera_model,
        "captured_utc": noise.captured_utc,
        "darks": noise.darks,
        "flats": noise.flats,
        "notes": list(transfer.notes),
        "maps": maps,
        "levels": [
            {
                "kind": sample.kind,
                "capture": sample.name,
                "exposure_us": sample.exposure_us,
                "mean_dn": sample.mean_dn,
                "variance_dn2": sample.variance_dn2,
                "pixels": sample.pixels,
                "frames": sample.frames,
                "clipped_fraction": sample.clipped_fraction,
                "is_fitted": is_fitted,
            }
            for sample, is_fitted in zip(transfer.samples, transfer.fitted, strict=True)
        ],
    }
