"""Name the part in the vice of a GRBL machine, and set G54 on it, with a ball probe.

python cnc_probe.py PORT OBJECTS X Y RADIUS BALL HEIGHT Z SAFE_Z: a ball of radius BALL touches the part
from the sides, HEIGHT over its bottom, at Z of the machine (mm). Only the part, within RADIUS of X, Y, may
stand above Z - BALL in RADIUS + 5 + 2 BALL. G59 becomes the machine's coordinates, as G38.3 knows no G53.
"""

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

    def search(self, target: str) -> tuple[bool, tuple[float, float]]:
        x, y, rest = self.send(f"G38.3 {target}")[5:].split(",")  # [PRB:1.000,2.000,3.000:1]
        return rest.endswith(":1]"), (float(x), float(y))

    def touch(self, way: palpate.FingerApproach) -> palpate.Contact:
        """Down beside the workspace, fast where nothing is, on to the part, again slowly, and back."""
        start, fast, end = (AT(*way.point_mm(far)) for far in (0, way.fast_mm, way.travel_mm))
        self.send(f"G0 Z{self.safe_z}", f"G0 {start}", f"G0 Z{self.z}", f"G0 {fast}")
        met, at_mm = self.search(f"{end} F300")
        if met:
            stop_mm = math.dist(way.start_mm, at_mm)
            self.send(f"G0 {AT(*way.point_mm(stop_mm - 1))}")
            met, at_mm = self.search(f"{AT(*way.point_mm(stop_mm + 1))} F60")
            self.send(f"G0 {start}")
        self.send(f"G0 Z{self.safe_z}")
        return palpate.Contact("probe", way.finger, met, way.start_mm, at_mm, way.position_bound_mm)


def locate(grbl: Grbl, objects: str, x: float, y: float, radius: float, tip: palpate.Finger) -> palpate.Plan:
    """Through the middle until the part was met three times; from then on as planned, to the verdict."""
    ways, half = [], radius + tip.tip_radius_mm + 2.5
    for aside in sorted(range(-int(radius), int(radius), 4), key=abs):
        for angle in (5 * side * math.pi / 8 for side in range(16)):  # each from quite another side
            u, v = math.cos(angle), math.sin(angle)
            start = x - half * u - aside * v, y - half * v + aside * u
            ways.append(palpate.FingerApproach(tip, start, angle, 2 * half, position_bound_mm=0.02))
    carrier = palpate.Carrier(ways, palpate.Goals(0.05, 0.002), travel_mm_s=30, search_mm_s=5)
    contacts: list[palpate.Contact] = []
    while sum(contact.touched for contact in contacts) < min(3, len(ways) - len(contacts)):
        contacts.append(grbl.touch(ways[len(contacts)]))
    while (plan := palpate.plan(carrier, objects, [[item] for item in contacts])).approaches:
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
        print(
            f"G54 is set; turn the program by {math.degrees(at.theta_rad):.3f}°. {plan.hypotheses[0].bounds}"
        )
