"""Measuring a rig by moving it; the fits that turn such measurements into a rig's numbers. Empty so far."""
