"""Diagnostics: checks of servos, arrays, adapters and calibration, bus scan, emergency stop."""
