"""Approaches that the fingers of a rig can take: swept volumes, free space, standby poses."""
