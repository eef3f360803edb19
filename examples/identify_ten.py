"""Identify ten parts in a row: python identify_ten.py [RIG.toml [OBJECTS.json [HOW-MANY [T.csv]]]]"""

import csv
import sys

import palpate


def main(rig: str | None = None, objects: str | None = None, how_many: str = "10", to: str = "t.csv") -> int:
    names, identified = ("verdict", "object", "state", "x", "y", "theta", "touches", "rig_seconds"), 0
    with palpate.open_rig(rig, seed=3) as opened, open(to, "w", newline="") as file:
        table = csv.DictWriter(file, names)
        table.writeheader()
        for part in range(1, int(how_many) + 1):
            if not opened.emulated:  # where each run draws the next part; torque is off between two runs
                input(f"Part {part} on the table, hands away? Press Enter. ")
            found = opened.identify(objects, sessions="palpate-sessions")
            place = {} if found.configuration is None else found.configuration.model_dump()
            table.writerow(found.result.model_dump(include=set(names)) | place)
            identified += found.verdict == "identified"
    return int(identified < int(how_many))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
