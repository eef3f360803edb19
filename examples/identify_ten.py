"""Identify ten parts in a row on one rig: python identify_ten.py [RIG.toml [OBJECTS.json [HOW-MANY]]]

Without a rig file: the emulated bench, on which each run draws the next part. On a real rig: change the part
when asked; torque is off then. Exit code 0 only if every part was identified.
"""

import sys

import palpate


def main(rig_file: str | None = None, objects_file: str | None = None, how_many: str = "10") -> int:
    runs = int(how_many)
    objects = palpate.load_objects(objects_file)
    identified = 0
    with palpate.open_rig(rig_file, seed=3) as rig:
        for run in range(1, runs + 1):
            if not rig.emulated:
                input(f"Part {run} of {runs}: put it on the table, hands away, then press Enter. ")
            answer = rig.identify(objects, sessions="palpate-sessions")
            identified += answer.verdict == "identified"
            place = (
                answer.configuration
                and f"x {answer.configuration.x:.2f} mm, y {answer.configuration.y:.2f} mm"
            )
            print(f"{run:2}  {answer.verdict:18} {answer.object or '-':10} {place or ''}")
    print(f"{identified} of {runs} identified")
    return 0 if identified == runs else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:4]))
