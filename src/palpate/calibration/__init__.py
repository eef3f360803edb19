"""Calibration: measurements that a rig makes of itself, and the estimators of values and bounds."""
