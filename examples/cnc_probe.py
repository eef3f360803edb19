"""Name the part in the vice of a GRBL machine, and set G54 on it, with a ball probe: give PORT OBJECTS and,
in mm, X Y RADIUS BALL HEIGHT Z SAFE_Z. A ball of radius BALL touches the part's sides HEIGHT over its bottom,
at Z of the machine. The part is within RADIUS of X, Y; nothing else may stand above Z - BALL in RADIUS + 5 +
2 BALL. G59 becomes the machine's coordinates, as G38.3 knows no G53.
"""

import cmath
import math
import sys
import time

import serial

import palpate

AT = "X{:.4f} Y{:.4f}".format


class Grbl:
    def __init__(self, port: str, z: float, safe_z: float) -> None:
        self.z, self.safe_z = z, safe_z
        self.wire = serial.serial_for_url(port, 115200, timeout=300)
        self.wire.write(b"\x18")
        time.sleep(2.0)  # an Arduino begins anew when its port is opened
        self.wire.reset_input_buffer()
        self.send("G21 G90 G94", "G92.1", "G49", "G10 L2 P6 X0 Y0 Z0", "G59")

    def send(self, *lines: str) -> str:
        found = ""
        for line in lines:
            self.wire.write(f"{line}\n".encode())
            while (answer := self.wire.readline().decode().strip()) != "ok":
                if not answer.startswith("["):
                    raise RuntimeError(f"{line}: {answer or 'no answer'}")
                found = answer
        return found

    def search(self, way: palpate.FingerApproach, far: float, feed: int) -> palpate.Contact:
        at, bound = AT(*way.point_mm(far)), way.position_bound_mm
        x, y, rest = self.send(f"G38.3 {at} F{feed}")[5:].split(",")  # [PRB:1.000,2.000,3.000:1]
        end = float(x), float(y)
        return palpate.Contact("probe", way.finger, rest.endswith(":1]"), way.start_mm, end, bound)

    def touch(self, way: palpate.FingerApproach) -> palpate.Contact:
        """Down beside the workspace, fast where no known part is, on to the part, again slowly, and back."""
        self.send(f"G0 Z{self.safe_z}", f"G0 {AT(*way.start_mm)}", f"G0 Z{self.z}")
        found = self.search(way, max(way.fast_mm, 1.0), 1200)
        found = found if found.touched else self.search(way, way.travel_mm, 300)
        if found.touched:
            self.send(f"G0 {AT(*way.point_mm(found.travel_mm - 1))}")
            found = self.search(way, found.travel_mm + 1, 60)
        self.send(f"G0 {AT(*way.start_mm)}", f"G0 Z{self.safe_z}")
        return found


def locate(grbl: Grbl, objects: str, x: float, y: float, radius: float, tip: palpate.Finger) -> palpate.Plan:
    """Through the middle until the part was met three times; from then on as planned, to the verdict."""
    ways, half = [], radius + tip.tip_radius_mm + 2.5
    for aside in sorted(range(-int(radius), int(radius), 4), key=abs):
        for angle in (5 * side * math.pi / 8 for side in range(16)):  # each from quite another side
            at = complex(x, y) + cmath.rect(-half, angle) + cmath.rect(aside, angle + math.pi / 2)
            ways.append(palpate.FingerApproach(tip, (at.real, at.imag), angle, 2 * half, 0.02))
    carrier = palpate.Carrier(ways, palpate.Goals(0.05, 0.002), travel_mm_s=20, search_mm_s=5)
    contacts: list[palpate.Contact] = []
    while sum(contact.touched for contact in contacts) < min(3, len(ways) - len(contacts)):
        contacts.append(grbl.touch(ways[len(contacts)]))
    while (plan := palpate.plan(carrier, objects, contacts)).approaches:
        contacts.append(grbl.touch(plan.approaches[0]))
    return plan


if __name__ == "__main__":
    x, y, radius, ball, height, z, safe_z = map(float, sys.argv[3:])
    grbl = Grbl(sys.argv[1], z, safe_z)
    plan = locate(grbl, sys.argv[2], x, y, radius, palpate.Finger(ball, height, shape=palpate.TipShape.BALL))
    print(plan.verdict, *(item.state.object_name for item in plan.hypotheses))
    if plan.verdict == "identified":
        at = plan.hypotheses[0].configuration
        grbl.send(f"G10 L2 P1 X{at.x_mm:.4f} Y{at.y_mm:.4f}", "G54")  # LinuxCNC turns it, too: R, in degrees
        print(f"turn the program by {math.degrees(at.theta_rad):.3f}°; {plan.hypotheses[0].bounds}")
