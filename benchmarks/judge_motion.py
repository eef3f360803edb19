"""Judge of runs on parts that move: reads what a run wrote and where the part really was, nothing else.

    python benchmarks/judge_motion.py FOLDER…

Each folder is a run of `bench_moving_part.py`: `result.json` (`palpate/identification@1`), `contacts.json`,
`hidden.json` (poses at each measurement and at the end, true peak forces) and `outline.json` (the part's
rings at each finger's height, in the object frame). Shares no code with palpate: shapely and arithmetic only.

Prints a row a claim and ends with exit code 1 if any is broken:
- the final pose is within the answer's bounds, if there is an answer, and the name is right;
- between two measurements the part moved by no more than the motion bounds of both grips say, in place and
  turn; what the engine creeps where a bound says that nothing moves is counted by itself;
- every stop is within its bound of the true outline at the pose of its instant;
- the outline's normal there is within the contact's range;
- no measured peak force is further from the true one than the array's gains allow.
"""

import argparse
import json
import math
import statistics
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import shapely
from shapely import affinity

_SLACK = 1e-6
_CREEP_MM, _CREEP_RAD = 0.003, 0.0002
"""MuJoCo's contacts creep under forces that friction holds, by less than 1 µm/s (tests/rig/emulated)."""
_AROUND = 12


@dataclass
class Verdicts:
    """Counts of what held and what did not, by claim."""

    held: Counter[str] = field(default_factory=Counter)
    broken: list[str] = field(default_factory=list)
    motions_mm: list[tuple[float, float]] = field(default_factory=list)

    def claim(self, name: str, holds: bool, what: str) -> None:
        """Count one."""
        self.held[name] += holds
        if not holds:
            self.broken.append(f"{name}: {what}")


def main() -> int:
    """Judge all folders that are given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    verdicts = Verdicts()
    for folder in parser.parse_args().folders:
        if (folder / "result.json").exists():
            judge(folder, verdicts)
        elif not (folder / "skipped.txt").exists():
            print(f"{folder.name}: no result")
    for name, count in sorted(verdicts.held.items()):
        broken = sum(line.startswith(name + ":") for line in verdicts.broken)
        print(f"{name:32} held {count:6}   broken {broken}")
    for line in verdicts.broken[:40]:
        print("  " + line)
    for least in (0.0, 0.01, 0.05, 0.2):
        print_tightness(verdicts.motions_mm, least)
    return 1 if verdicts.broken else 0


def print_tightness(motions_mm: list[tuple[float, float]], least_mm: float) -> None:
    """How wide the bounds are beside true motions of at least so much: medians, and of their ratio."""
    found = [(true, most) for true, most in motions_mm if true >= max(least_mm, _SLACK)]
    if found:
        true, most, ratio = (
            statistics.median(values) for values in zip(*((t, m, m / t) for t, m in found), strict=True)
        )
        medians = f"true {true:.4f}, bound {most:.3f} mm, ratio {ratio:.1f}"
        print(f"moved by {least_mm:g} mm at least: {len(found)}, medians: {medians}")


def judge(folder: Path, verdicts: Verdicts) -> None:
    """Hold one run against the truth."""
    result, hidden = (json.loads((folder / name).read_text()) for name in ("result.json", "hidden.json"))
    _answer(folder.name, result, hidden, verdicts)
    _motions(folder.name, result, hidden, verdicts)
    _stops(folder, hidden, verdicts)
    _forces(folder.name, result, hidden, verdicts)


def _answer(run: str, result: dict[str, Any], hidden: dict[str, Any], verdicts: Verdicts) -> None:
    if result["verdict"] not in ("identified", "indistinguishable"):
        verdicts.claim("never unknown", result["verdict"] != "unknown", run)
        return
    answers = [result, *result["alternatives"]]
    right = [a for a in answers if (a["object"], a["state"]) == (hidden["object"], hidden["state"])]
    verdicts.claim("right name", bool(right), f"{run}: {result['object']}, not {hidden['object']}")
    if right:
        inside = any(_inside(a["bounds"], hidden) for a in right)
        verdicts.claim("final pose inside bounds", inside, f"{run}: {hidden['final']}")


def _inside(bounds: dict[str, Any], hidden: dict[str, Any]) -> bool:
    """Whether the final pose, turned by the state's symmetry as need be, is within bounds."""
    order, (cx, cy) = hidden["symmetry_order"], hidden["centroid"]
    x, y, theta = hidden["final"]
    for k in range(order):
        turned = theta + 2 * math.pi * k / order
        x_k = x + math.cos(theta) * cx - math.sin(theta) * cy - math.cos(turned) * cx + math.sin(turned) * cy
        y_k = y + math.sin(theta) * cx + math.cos(theta) * cy - math.sin(turned) * cx - math.cos(turned) * cy
        lo, hi = bounds["theta"]
        off = math.remainder(turned - (lo + hi) / 2, 2 * math.pi)
        if abs(off) <= (hi - lo) / 2 + _SLACK and all(
            low - _SLACK <= value <= high + _SLACK
            for value, (low, high) in ((x_k, bounds["x"]), (y_k, bounds["y"]))
        ):
            return True
    return False


def _motions(run: str, result: dict[str, Any], hidden: dict[str, Any], verdicts: Verdicts) -> None:
    """Motion from one measurement to the next, and after the last, against the bounds of both grips."""
    if not result.get("motion_bounds"):
        return
    poses = [*hidden["at_measurement"], hidden["final"]]
    cx, cy = hidden["centre_of_friction"]
    middles = [_placed(pose, cx, cy) for pose in poses]
    bounds = {item["grip"]: item for item in result["motion_bounds"]}
    for k in range(1, len(poses)):  # from grip k's measurement to the next grip's, or to the end
        both = [bounds[n] for n in (k, k + 1) if n in bounds]
        if any(item["position"] is None for item in both):
            continue
        moved = math.dist(middles[k - 1], middles[k])
        turned = abs(math.remainder(poses[k][2] - poses[k - 1][2], 2 * math.pi))
        for name, value, most, creep in (
            ("motion", moved, sum(item["position"] for item in both), _CREEP_MM),
            ("turn", turned, sum(item["orientation"] for item in both), _CREEP_RAD),
        ):
            claim = f"{name} within its bound" + (" and the engine's creep" if value > most + _SLACK else "")
            what = f"{run} grip {k}: {value:.5f} of {most:.5f}"
            verdicts.claim(claim, value <= most + creep, what)
            if name == "motion":
                verdicts.motions_mm.append((value, most))


def _placed(pose: list[float], x: float, y: float) -> tuple[float, float]:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return pose[0] + c * x - s * y, pose[1] + s * x + c * y


def _stops(folder: Path, hidden: dict[str, Any], verdicts: Verdicts) -> None:
    contacts = json.loads((folder / "contacts.json").read_text())
    rings = json.loads((folder / "outline.json").read_text())
    for grip, pose in zip(contacts["grips"], hidden["at_measurement"], strict=False):
        for contact in grip["contacts"]:
            if not contact["touched"]:
                continue
            shape = shapely.MultiLineString(
                [shapely.LineString([*ring, ring[0]]) for ring in rings[f"{contact['height']:g}"]]
            )
            at = affinity.translate(
                affinity.rotate(shape, pose[2], origin=(0, 0), use_radians=True), pose[0], pose[1]
            )
            off = abs(at.distance(shapely.Point(contact["centre"])) - contact["tip_radius"])
            what = f"{folder.name} {contact['finger']}: {off:.4f} of {contact['position_bound']:.4f} mm"
            verdicts.claim("stop within its bound", off <= contact["position_bound"] + _SLACK, what)
            _normal(folder.name, at, contact, verdicts)


def _normal(run: str, outline: shapely.Geometry, contact: dict[str, Any], verdicts: Verdicts) -> None:
    """The outward normal where the true tip's centre may have been: anywhere within the position bound."""
    if "normal" not in contact:
        return
    lo, hi = contact["normal"]
    x, y = contact["centre"]
    reach = contact["position_bound"]
    off = []
    for k in range(-1, _AROUND):
        away, at = (0.0 if k < 0 else reach), 2 * math.pi * k / _AROUND
        centre = shapely.Point(x + away * math.cos(at), y + away * math.sin(at))
        foot = shapely.line_interpolate_point(outline, shapely.line_locate_point(outline, centre))
        normal = math.atan2(centre.y - foot.y, centre.x - foot.x)
        off.append(abs(math.remainder(normal - (lo + hi) / 2, 2 * math.pi)) - (hi - lo) / 2)
    what = f"{run} {contact['finger']}: {math.degrees(min(off)):.2f}° beyond its range"
    verdicts.claim("normal within its range", min(off) <= _SLACK, what)


def _forces(run: str, result: dict[str, Any], hidden: dict[str, Any], verdicts: Verdicts) -> None:
    """Measured peaks against the true ones of the same grip and finger, within the arrays' gains."""
    measured: dict[tuple[int, str], float] = {}
    for record in result.get("touch_records", ()):
        key = (record["grip"], record["finger"])
        measured[key] = max(measured.get(key, 0.0), record["peak_force_n"])
    for key, peak in measured.items():
        true = hidden["peaks_n"].get(f"{key[0]} {key[1]}")
        if true is None:
            continue
        low, high = true / (1 + hidden["gain_spread"]), true * (1 + hidden["gain_spread"])
        slack = hidden["noise_n"]
        what = f"{run} grip {key[0]} {key[1]}: {peak:.3f} N, true {true:.3f} N"
        verdicts.claim("peak force within gains", low - slack <= peak <= high + slack, what)


if __name__ == "__main__":
    sys.exit(main())
