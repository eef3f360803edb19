"""Ports, clocks and the seam to devices: bytes in, bytes out, nothing about what they mean."""
