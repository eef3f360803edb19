"""Sweep a value of the rig file: python sweep_speed.py [RIG.toml [OBJECTS.json]]"""

import sys

import palpate

rig, objects = palpate.open_rig(*sys.argv[1:2], seed=7), palpate.load_objects(*sys.argv[2:3])
print("mm/s  seconds  touches  newtons  half-width mm")
for speed in (4.0, 6.0, 10.0):
    found = rig.with_(closing={"search_speed_mm_s": speed}).identify(objects)
    peak_n = max(load.peak_force_n for touch in found.touches for load in touch.loads)
    half_mm = (found.bounds.x[1] - found.bounds.x[0]) / 2 if found.bounds else float("nan")
    print(f"{speed:4g}  {found.rig_seconds:7.1f}  {len(found.touches):7}  {peak_n:7.2f}  {half_mm:13.2f}")
