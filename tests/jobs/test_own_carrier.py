"""A carrier of one's own: any machine that moves a tip, and a ball probe on a GRBL machine as an example."""

import json
import math
import os
import pty
import re
import subprocess
import sys
import threading
import tty
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
import serial
import shapely

import palpate
from support.campaign.sampling import sample
from support.commands.repository import EXAMPLES, ROOT
from support.devices.grbl.grbl import SETTINGS, WHY_NOT, Machine, build
from support.oracles.shapely_touches import (
    Placed,
    first_contact,
    flat,
    holding_truth,
    place_within,
    unit,
)

LOOP = (ROOT / "docs/own-carrier.md").read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
OUTLINES = {
    "wedge": [[0, 0], [70, 0], [70, 25], [55, 40], [0, 40]],
    "angle": [[0, 0], [60, 0], [60, 20], [20, 20], [20, 50], [0, 50]],
    "slab": [[0, 0], [64, 0], [64, 30], [0, 30]],
    "kite": [[0, 0], [50, 10], [60, 45], [15, 38]],
}
MODELS = [flat(name, outline) for name, outline in OUTLINES.items()]
MIDDLE_MM = np.array([-200.0, -150.0])
BALL = palpate.Finger(1.5, 10.0, shape=palpate.TipShape.BALL)


@pytest.fixture(scope="module")
def objects(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The outlines as a file."""
    parts = [{"name": name, "outline": outline, "height": 20.0} for name, outline in OUTLINES.items()]
    path = tmp_path_factory.mktemp("parts") / "parts.json"
    path.write_text(json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": parts}))
    return path


def drawn(seed: int) -> Placed:
    """A part somewhere about the middle of the machine's workspace."""
    rng = np.random.default_rng(seed)
    found = place_within(MODELS[seed % len(MODELS)], rng)
    return replace(found, x=found.x + MIDDLE_MM[0], y=found.y + MIDDLE_MM[1])


def ways(bound_mm: float) -> list[palpate.FingerApproach]:
    """Lines from twelve sides, 6 mm apart."""
    angles = [7 * k % 12 * math.pi / 6 for k in range(12)]
    starts = [
        (angle, MIDDLE_MM - 75 * unit(angle) + k * unit(angle + math.pi / 2))
        for k in sorted(range(-48, 49, 6), key=abs)
        for angle in angles
    ]
    return [palpate.FingerApproach(BALL, (at[0], at[1]), angle, 150.0, bound_mm) for angle, at in starts]


@pytest.mark.parametrize("seed", sample(range(40), [1, 6]))
def test_a_carrier_that_stands_anywhere_needs_no_normals(objects: Path, seed: int) -> None:
    """The loop of the page: errors are at their bounds; what is planned is free as far as it says."""
    placed, rng = drawn(seed), np.random.default_rng(seed)
    names: dict[str, object] = {"approaches": ways(0.02), "palpate": palpate}

    def touch(way: palpate.FingerApproach) -> palpate.Contact:
        made = names["contacts"]
        assert isinstance(made, list)
        assert len(made) < 30, "the loop ends"
        start, heading = np.array(way.start_mm), unit(way.direction_rad)
        error = way.position_bound_mm * unit(rng.uniform(0, 2 * math.pi))
        travel = first_contact(placed.shape, start + error, heading, BALL.tip_radius_mm, way.travel_mm)
        assert travel > way.fast_mm
        end, met = way.point_mm(min(travel, way.travel_mm)), math.isfinite(travel)
        return palpate.Contact("probe", BALL, met, way.start_mm, end, way.position_bound_mm)

    exec(LOOP.replace('"my-parts.json"', repr(str(objects))), names | {"touch": touch}, names)
    plan, contacts = names["plan"], names["contacts"]
    assert isinstance(plan, palpate.Plan)
    assert isinstance(contacts, list)
    assert plan.verdict == "identified"
    assert holding_truth(plan.planned.recognition, placed) is plan.hypotheses[0]
    assert plan.hypotheses[0].search_bounds.position_half_mm <= 0.05
    assert len(contacts) <= 12
    assert json.loads(plan.to_json())["approaches"] == []
    assert plan.picture().startswith("<svg")


def test_a_plan_for_a_carrier_can_be_shown(objects: Path) -> None:
    way = ways(0.02)[0]
    start, heading = np.array(way.start_mm), unit(way.direction_rad)
    x, y = start + first_contact(drawn(0).shape, start, heading, BALL.tip_radius_mm, 150.0) * heading
    met = palpate.Contact("probe", BALL, True, way.start_mm, (x, y), 0.02)
    plan = palpate.plan(palpate.Carrier(ways(0.02), name="mill"), objects, [met])
    assert [item["finger"] for item in json.loads(plan.to_json())["approaches"]] == ["mill"]
    assert "mill" in plan.picture()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"approaches": []}, "one approach or more"),
        ({"approaches": [3]}, "one approach or more"),
        ({"approaches": [replace(ways(0.02)[0], travel_mm=0.0)]}, "go more than 0"),
        ({"approaches": [replace(ways(0.02)[0], position_bound_mm=math.nan)]}, "must be finite"),
        (
            {
                "approaches": [
                    replace(ways(0.02)[0], finger=palpate.Finger(5.0, 10.0, shape=palpate.TipShape.PAD))
                ]
            },
            "must be round",
        ),
        ({"approaches": [replace(ways(0.02)[0], start_mm=(0.0, 0.0, 0.0))]}, "start at x and y"),
        ({"approaches": [replace(ways(0.02)[0], travel_mm="10")]}, "must be finite"),
        ({"approaches": [replace(ways(0.02)[0], finger="probe")]}, "must be a palpate.Finger"),
        ({"search_mm_s": 0.0}, "speeds"),
        ({"travel_mm_s": "fast"}, "speeds"),
        ({"goals": (0.1, 0.1)}, "goals must be palpate.Goals"),
        ({"false_match_probability": 2.0}, "false_match_probability"),
    ],
)
def test_a_carrier_that_cannot_be_is_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(palpate.InputError, match=words):
        palpate.Carrier(**{"approaches": ways(0.02), **change})  # type: ignore[arg-type]


# ----------------------------------------------------------------------------------------------------
# examples/cnc_probe.py, against answers as grbl's documentation has them, and against grbl.


@dataclass
class Dialogue:
    """A machine that answers as grbl 1.1's interface page says, and checks each rapid motion."""

    part: shapely.Geometry
    alarm_at: int = 10**9  # search that ends in an alarm
    said: list[str] = field(default_factory=list)
    at: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    struck: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.wire, other = pty.openpty()
        tty.setraw(other)
        self.port, self.other = os.ttyname(other), other
        self.thread = threading.Thread(target=self.serve)
        self.thread.start()

    def close(self) -> None:
        os.close(self.other)
        self.thread.join(timeout=60)
        os.close(self.wire)

    def serve(self) -> None:
        rest = b""
        with suppress(OSError):  # the other end is closed
            while True:
                *lines, rest = (rest + os.read(self.wire, 1000)).split(b"\n")
                if rest == b"\x18":
                    os.write(self.wire, b"\r\nGrbl 1.1h ['$' for help]\r\n")
                    rest = b""
                for line in lines:
                    self.said.append(line.decode())
                    os.write(self.wire, self.answer(self.said[-1]).encode() + b"\r\n")

    def answer(self, line: str) -> str:
        words = {letter: float(value) for letter, value in re.findall(r"([A-Z])(-?[\d.]+)", line)}
        begin = np.array(self.at[:2])
        end = np.array([words.get("X", self.at[0]), words.get("Y", self.at[1])])
        z = words.get("Z", self.at[2])
        if words["G"] == 0:
            swept = shapely.LineString([begin, end]).buffer(1.49)
            if min(z, self.at[2]) < -30 and swept.intersects(self.part):
                self.struck.append(line)
            self.at = [*end.tolist(), z]
        if words["G"] != 38.3:
            return "ok"
        if sum("G38.3" in item for item in self.said) == self.alarm_at:
            return "ALARM:4"
        far, heading = math.dist(begin, end), (end - begin) / math.dist(begin, end)
        travel = first_contact(self.part, begin, heading, 1.5, far)
        x, y = begin + min(travel, far) * heading
        self.at[:2] = [x, y]
        return f"[PRB:{x:.3f},{y:.3f},{z:.3f}:{int(travel <= far)}]\r\nok"


def run(port: str, objects: Path) -> subprocess.CompletedProcess[str]:
    """Run the example: workspace of 75 mm about the middle, ball at Z-40, safe from Z-10 on."""
    numbers = [*MIDDLE_MM.tolist(), 75, BALL.tip_radius_mm, BALL.height_mm, -40, -10]
    command = [sys.executable, EXAMPLES / "cnc_probe.py", port, objects, *map(str, numbers)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)


def check(done: subprocess.CompletedProcess[str], placed: Placed, origin_mm: tuple[float, float]) -> None:
    """What it printed, and where it has put the origin of G54, is where the part is."""
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("identified")
    assert placed.model.name in done.stdout
    turned_deg = float(re.findall(r"by (-?[\d.]+)°", done.stdout)[0])
    order = 2 if placed.model.name == "slab" else 1
    off_deg = math.remainder(turned_deg - math.degrees(placed.theta), 360 / order)
    assert abs(off_deg) < 0.12
    turn = math.radians(turned_deg - off_deg)
    about = placed.on_table(np.array([32.0, 15.0])) if order == 2 else np.array([placed.x, placed.y])
    corner = np.array([32.0, 15.0]) if order == 2 else np.zeros(2)
    expected = (
        about - np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]) @ corner
    )
    assert math.dist(origin_mm, expected) < 0.15


@pytest.mark.parametrize("seed", sample(range(8), [2]))
def test_the_probe_names_the_part_and_sets_its_origin(objects: Path, seed: int) -> None:
    placed = drawn(seed)
    with closing(Dialogue(placed.shape)) as machine:
        done = run(machine.port, objects)
    origin = re.findall(r"G10 L2 P1 X(-?[\d.]+) Y(-?[\d.]+)", "\n".join(machine.said))
    check(done, placed, (float(origin[0][0]), float(origin[0][1])))
    assert machine.struck == []
    assert machine.at[2] == -10


def test_an_alarm_ends_the_example(objects: Path) -> None:
    with closing(Dialogue(drawn(0).shape, alarm_at=3)) as machine:
        done = run(machine.port, objects)
    assert done.returncode == 1
    assert re.search(r"RuntimeError: G38\.3 .*ALARM:4", done.stderr)
    assert "G38.3" in machine.said[-1]


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    """A machine with grbl's own firmware."""
    made = Machine(build(tmp_path_factory.mktemp("grbl")), BALL.tip_radius_mm, top_mm=-30.0)
    with serial.Serial(made.port, 115200, timeout=10) as wire:
        for line in SETTINGS:
            wire.write(f"{line}\n".encode())
            assert wire.read_until(b"ok\r\n").endswith(b"ok\r\n")
    with closing(made):
        yield made


@pytest.mark.skipif(WHY_NOT is not None, reason=str(WHY_NOT))
@pytest.mark.parametrize("seed", [2, 3])
def test_the_probe_does_so_with_grbl_itself(machine: Machine, objects: Path, seed: int) -> None:
    """The ball is beside where grbl has it by nearly its bound; out of a search it meets nothing."""
    placed, rng = drawn(seed), np.random.default_rng(seed)
    machine.part, machine.overlap_mm = placed.shape, 0.0
    machine.draw_error = lambda: tuple((0.0175 * unit(rng.uniform(0, 2 * math.pi))).tolist())  # type: ignore[assignment, return-value]
    done = run(machine.port, objects)
    with serial.Serial(machine.port, 115200, timeout=10) as wire:
        wire.write(b"$#\nG4 P0.01\n")  # the second is answered when the machine stands
        offsets = "".join(wire.read_until(b"ok\r\n").decode() for _ in range(2))
    x, y, _ = re.findall(r"\[G54:(-?[\d.]+),(-?[\d.]+),(-?[\d.]+)\]", offsets)[0]
    check(done, placed, (float(x), float(y)))
    assert machine.overlap_mm < 0.5, "what a search at 5 mm/s goes on for"
