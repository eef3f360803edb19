"""Commissioning of a rig: motor setup and calibration runs."""
