"""Edges as they come from a measurement, with chosen values."""

from calibration.edges import EdgeMeasurement


def edge_of(angle_deg: object = 95.0, **changes: object) -> EdgeMeasurement:
    return EdgeMeasurement.model_validate(
        {
            "image": "edge.tif",
            "capture": 0,
            "height_mm": 100.0,
            "x_px": 55.0,
            "y_px": 45.0,
            "angle_deg": angle_deg,
            "orientation": "vertical",
            "length_px": 60.0,
            "snr": 100.0,
            "sigma_px": 0.7,
            "sigma_err_px": 0.01,
            "optical_sigma_px": 0.64,
            "optical_sigma_err_px": 0.011,
            "mtf50_cy_per_px": 0.27,
            "chi2_reduced": 1.0,
            "flags": [],
            **changes,
        }
    )
