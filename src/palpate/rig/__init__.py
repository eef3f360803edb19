"""Operation of a rig: drives, reach, guarded motion, identification, sessions, the emulated bench.

`bench` is the composition root: it alone connects a rig file to real ports or to emulated devices.
"""
