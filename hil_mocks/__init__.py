"""The simulated bench that stands in for camera, stage and scene."""
