"""Measuring a rig by moving it, and the fits that turn what it felt into its numbers and their bounds."""
