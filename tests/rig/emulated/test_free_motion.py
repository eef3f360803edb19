"""Motion of the emulated rig in the air, and a rig as bought."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.base.errors import InputError
from palpate.config import load_objects, load_rig, shipped_objects
from palpate.drivers.dynamixel.packet import Instruction, InstructionPacket, encode_instruction
from palpate.drivers.emulators.bench import Bench
from palpate.drivers.emulators.part import StillParts
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.tactile.codec import encode
from palpate.drivers.tactile.messages import Hello, Message, Start
from palpate.drivers.transport.wire import Emission
from palpate.rig.bench import choose_placements
from palpate.rig.contact_peak import bus_latency_s, expected_peak_n
from palpate.rig.emulated.devices import emulate
from support.benches.as_bought import ROWS, rig_of, run_row
from support.campaign.sampling import sample

# ----------------------------------------------------------------------------------------------------
# Free motion that is taken at once against the same motion in single steps: the same bytes, the same truth.
#
# A part that never rests keeps a bench from taking steps together, and is otherwise a part that stands still.

ROOT = Path(__file__).parents[3]
_SHIPPED = "src/palpate/config/rigs"
RIGS = (f"{_SHIPPED}/bench.toml", f"{_SHIPPED}/xl330-bench.toml", "examples/two-link-rig.toml")
MODE, TORQUE, WATCHDOG, PROFILE, GOAL, PRESENT = 11, 64, 98, 112, 116, 122
EXTENDED_POSITION = 4
EVENTS = 250


class Restless(StillParts):
    at_rest = False


@dataclass
class World:
    """An emulated rig and all that it said."""

    bench: Bench
    chain: ServoChain
    arrays: list[Any]
    said: list[tuple[str, Emission]] = field(default_factory=list)
    truths: list[float] = field(default_factory=list)

    def tell(self, packet: InstructionPacket, now: float) -> None:
        self.said += [("bus", item) for item in self.chain.feed(encode_instruction(packet), now)]

    def look(self, now: float) -> None:
        self.said += [("bus", item) for item in self.chain.poll(now)]
        for number, array in enumerate(self.arrays):
            self.said += [(str(number), item) for item in array.poll(now)]

    def see(self) -> None:
        for finger in self.bench.fingers:
            self.truths += [*finger.centre_mm.tolist(), finger.facing_rad, finger.hardest_n]
            self.truths += [value for s in finger.servos for value in (s.shaft_rad, s.shaft_rad_s)]


def world(rig_file: str, seed: int, *, restless: bool) -> World:
    rig = load_rig(ROOT / rig_file)
    (placement,) = choose_placements(rig, load_objects(shipped_objects()), None, seed)
    emulated = emulate(rig, [placement], seed)
    emulated.bench.parts = Restless(1) if restless else StillParts(1)
    chain = emulated.devices[rig.bus.port][0]
    assert isinstance(chain, ServoChain)
    return World(emulated.bench, chain, [finger.array for finger in emulated.bench.fingers])


def ids(bench: Bench) -> list[int]:
    return [servo.dxl_id for finger in bench.fingers for servo in finger.servos]


def happen(world: World, seed: int) -> int:
    """Let the same things happen by chance: goals, profiles, watchdogs, supplies, reads. Counts presses."""
    rng, now, pressed = np.random.default_rng(seed), 0.01, 0
    servos = [servo for finger in world.bench.fingers for servo in finger.servos]
    for array in world.arrays:
        array.feed(b"\0" + encode(Message(0, 0, Hello(1))), now)
        array.feed(encode(Message(1, 0, Start(2, 250_000))), now)
    for dxl_id in ids(world.bench):
        world.tell(write(dxl_id, MODE, EXTENDED_POSITION, 1), now)
        world.tell(write(dxl_id, TORQUE, 1, 1), now)
    for _ in range(EVENTS):
        now += float(rng.choice([2e-4, 1e-3, 4e-3, 4.1e-3, 0.02, 0.11])) * rng.uniform(0.5, 1.0)
        index, kind = int(rng.integers(len(servos))), rng.uniform()
        dxl_id, servo = servos[index].dxl_id, servos[index]
        if kind < 0.15:
            world.tell(write(dxl_id, PROFILE, int(rng.integers(0, 60)), 4), now)
        elif kind < 0.4:
            further = rng.uniform(-200, 200) if index % 2 == 0 else rng.uniform(-1000, 6000)
            ticks = servo.shaft_rad * 4096 / (2 * np.pi) + 2048 + further
            world.tell(write(dxl_id, GOAL, int(ticks) & 0xFFFFFFFF, 4), now)
        elif kind < 0.41:
            world.tell(write(dxl_id, WATCHDOG, int(rng.integers(0, 8)), 1), now)
        elif kind < 0.42:
            servo.set_supply(float(rng.choice([3.0, 4.0, 12.0])))
            servo.set_supply(12.0)
        elif kind < 0.5:
            world.tell(write(dxl_id, TORQUE, int(rng.uniform() < 0.8), 1), now)
        elif kind < 0.6:
            world.see()
        elif kind < 0.75:
            params = bytes((PRESENT, 0, 22, 0, *ids(world.bench)))
            world.tell(InstructionPacket(0xFE, Instruction.SYNC_READ, params), now)
        world.look(now)
        pressed += any(finger.press is not None for finger in world.bench.fingers)
    world.see()
    return pressed


def write(dxl_id: int, address: int, value: int, size: int) -> InstructionPacket:
    data = value.to_bytes(size, "little")
    return InstructionPacket(dxl_id, Instruction.WRITE, address.to_bytes(2, "little") + data)


@pytest.mark.parametrize("seed", sample(range(3), [0]))
@pytest.mark.parametrize("rig_file", RIGS)
def test_steps_taken_together_change_nothing(rig_file: str, seed: int) -> None:
    at_once = world(rig_file, seed, restless=False)
    by_steps = world(rig_file, seed, restless=True)
    happen(at_once, seed)
    happen(by_steps, seed)
    assert at_once.truths == by_steps.truths
    assert at_once.said == by_steps.said


def test_some_of_these_runs_touch_the_part() -> None:
    assert any(happen(world(RIGS[0], seed, restless=False), seed) for seed in range(3))


# ----------------------------------------------------------------------------------------------------
# Adapters and mechanics as bought: runs end right or with their own message, and never with torque on.

BY_NAME = {row.name: row for row in ROWS}


@pytest.mark.parametrize(
    ("name", "kind"),
    sample(
        [
            ("latency timer of 16 ms everywhere", "right"),
            ("an array resets in a run", "right"),
            ("3 … 4 times the friction at rest", "message"),
        ],
        [("3 … 4 times the friction at rest", "message")],
    ),
)
def test_a_run_ends_as_its_row_says(name: str, kind: str) -> None:
    found = run_row(BY_NAME[name], 1)
    assert (found.kind, found.torque_on) == (kind, ()), found


def test_torque_is_off_after_the_bus_came_back_under_another_name_which_is_said() -> None:
    found = run_row(BY_NAME["bus's adapter comes back under another name"], 2)
    assert (found.kind, found.torque_on) == ("message", ())
    assert "has come back as" in found.text
    assert "/dev/serial/by-id" in found.text


def test_a_screw_that_slips_is_found_at_the_stops() -> None:
    found = run_row(BY_NAME["a screw that slips, with check_slips"], 4)
    assert (found.kind, found.torque_on) == ("message", ()), found
    assert "finger f2: its slide (servo 22) meets its back stop" in found.text


def test_slips_cannot_be_checked_without_stops() -> None:
    row = BY_NAME["a screw that slips, with check_slips"]
    with pytest.raises(ValueError, match=r"no slide\.stops_mm to meet"):
        rig_of(type(row)(row.name, row.emulation, bounds=row.bounds[:1]))


def test_latency_is_in_the_expected_peak() -> None:
    quick, slow = (rig_of(BY_NAME[name]) for name in ("as it should be", "latency timer of 16 ms everywhere"))
    assert bus_latency_s(slow) == pytest.approx(0.034)
    more_mm = quick.closing.search_mm_s * (0.034 - 0.001 + 0.016)
    stiffest = max(finger.tip.stiffness_n_per_mm for finger in quick.fingers)
    speed = quick.closing.search_mm_s
    assert expected_peak_n(slow, speed) - expected_peak_n(quick, speed) == pytest.approx(stiffest * more_mm)


def test_slides_that_give_way_more_than_declared_are_refused() -> None:
    row = BY_NAME["slides that give way under load"]
    with pytest.raises((InputError, ValueError), match="beyond the bound"):
        rig_of(type(row)(row.name, row.emulation))
