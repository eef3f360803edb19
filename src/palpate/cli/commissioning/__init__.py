"""Commands that set up and measure a rig: `setup-motors` and `calibrate`."""
