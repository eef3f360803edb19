"""Examining a rig without moving it: servos, arrays, adapters, calibration."""
