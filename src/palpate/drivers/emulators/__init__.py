"""Stand-ins for the devices, from the wire on: servos, arrays, and the mechanics between them.

At the far end of the data's way, where a real rig has hardware. Imported by rig's composition root and by
tests alone; `docs/emulation.md` says what is modelled and what is not.
"""
