"""Recognise a part from contacts alone: python recognise_contacts.py CONTACTS.json [OBJECTS.json]

Contacts may come from anywhere: another hand, a simulation, a file. Nothing moves.
"""

import sys

import palpate


def main(contacts_file: str, objects_file: str | None = None) -> int:
    objects = palpate.load_objects(objects_file)
    answer = palpate.recognise(objects, contacts_file)
    print(f"{answer.verdict}: {len(answer.hypotheses)} hypotheses")
    for item in answer.hypotheses[:5]:
        at, bounds = item.configuration, item.bounds
        print(f"  {item.state.object_name}, {item.state.state.name}: x {at.x_mm:.2f} mm in {bounds.x_mm}")
    plan = palpate.plan(palpate.load_rig(), objects, contacts_file)
    print(f"next grip: {plan!r}")
    return 0 if answer.verdict == "unique" else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:3]))
