"""Free motion that is taken at once against the same motion in single steps: the same bytes, the same truth.

A part that never rests keeps a bench from taking steps together, and is otherwise a part that stands still.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.config import load_objects, load_rig, shipped_objects
from palpate.drivers.dynamixel.packet import Instruction, InstructionPacket, encode_instruction
from palpate.drivers.emulators.bench import Bench
from palpate.drivers.emulators.part import StillPart
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.tactile.codec import encode
from palpate.drivers.tactile.messages import Hello, Message, Start
from palpate.drivers.transport.wire import Emission
from palpate.rig.bench import choose_placement
from palpate.rig.emulated.devices import emulate

ROOT = Path(__file__).parents[3]
_SHIPPED = "src/palpate/config/rigs"
RIGS = (f"{_SHIPPED}/bench.toml", f"{_SHIPPED}/xl330-bench.toml", "examples/two-link-rig.toml")
MODE, TORQUE, WATCHDOG, PROFILE, GOAL, PRESENT = 11, 64, 98, 112, 116, 122
EXTENDED_POSITION = 4
EVENTS = 250


class Restless(StillPart):
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
    placement = choose_placement(rig, load_objects(shipped_objects()), None, seed)
    emulated = emulate(rig, placement, seed)
    emulated.bench.part = Restless() if restless else StillPart()
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


@pytest.mark.parametrize("seed", range(3))
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
