"""Touch in an order of one's own, one finger at a time: python own_order.py [RIG.toml [OBJECTS.json]]"""

import sys

import palpate

objects = palpate.load_objects(*sys.argv[2:3])
with palpate.open_rig(*sys.argv[1:2], seed=7).connect(objects) as rig:
    known, fingers = rig.recognise(objects), range(len(rig.file.fingers))
    for aside_mm in (0.0, 10.0, 20.0):  # past the middle of the table
        for finger in fingers:
            ways = [way for way in rig.approaches if way.finger_index == finger]
            way = min(ways, key=lambda way: abs(way.aside_mm(0.0, 0.0) - aside_mm))
            known = known.extend(rig.touch(way))
            print(known, *known.grips[-1])
