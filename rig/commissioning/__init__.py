"""Setting up and calibrating a rig: motors, calibration runs, the quick re-touch."""
