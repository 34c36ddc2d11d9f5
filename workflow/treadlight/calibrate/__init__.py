"""Calibration: camera, reference plane, laser plane, rotation axis, LEDs, illumination."""
