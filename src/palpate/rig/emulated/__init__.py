"""The emulated rig: its devices, what lies on its table, and the truth that answers are compared with."""
