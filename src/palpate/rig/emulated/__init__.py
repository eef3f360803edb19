"""The emulated rig: its devices, the part on its table, and the truth with which answers are compared."""
