"""Calibration: what a rig measures of itself, and the estimators of values and bounds."""
