"""Composition root: from a rig file to a usable hand, on real ports or on emulated devices.

With `emulated.devices` and `emulated.scene`, which it calls, the only part of a run that knows the
emulators.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from serial.serialutil import SerialBase

from palpate.base.errors import InputError
from palpate.config import ObjectsFile, RigFile, Scene
from palpate.drivers.transport import (
    Clock,
    FollowedPorts,
    MonotonicClock,
    PortSharing,
    Recorder,
    RecordSink,
    SystemPlugs,
)
from palpate.rig.catalogue.finger_model import check_known
from palpate.rig.contact_peak import bus_latency_s
from palpate.rig.emulated.devices import EmulatedRig, MockRig, emulate, on_mock_wires
from palpate.rig.emulated.scene import Placement, ReferencePlacer
from palpate.rig.emulated.table import draw_placements, placements_of
from palpate.rig.identification.part_count import ONE_PART, PartCount
from palpate.rig.mechanisms import lowest_links
from palpate.rig.motion.hand import Environment, Hand

_APART_MM = 3.0  # more than touches push parts


@dataclass(frozen=True, eq=False)
class BenchRig:
    """A rig that is ready to be connected: its clock, how to open its ports, and what only emulators know.

    `placements`: of the parts on an emulated table.
    """

    rig: RigFile
    clock: Clock
    urls: Callable[[str], str]
    placements: tuple[Placement, ...]
    mock: MockRig | None

    @property
    def emulated(self) -> EmulatedRig | None:
        """The emulated devices with their hidden truth; None on a real rig."""
        return None if self.mock is None else self.mock.rig


def choose_placements(
    rig: RigFile, objects: ObjectsFile, scene: Scene | None, seed: int, asked: PartCount = ONE_PART
) -> tuple[Placement, ...]:
    """Choose what lies on the table of an emulated rig; nothing for a real one.

    `asked`: how many parts are sought; as many are drawn, unless the rig file says how many. Raises
    InputError for a scene on a real rig, or one that does not fit the catalogue, for an object that is too
    high for an arm's links to pass above it, and for one that is not known where a finger is.
    """
    check_known(objects.objects, rig.fingers)
    check_heights(rig, objects)
    if rig.emulation is None:
        if scene is not None:
            raise InputError(f'a scene is for emulated rigs; rig "{rig.name}" has real devices')
        return ()
    if scene is not None:
        placements = placements_of(scene, objects)
        check_known([item.model for item in placements], rig.fingers)  # they may come from other files
        return placements
    return draw_table(rig, objects, np.random.default_rng([seed, 0]), asked)


def draw_table(
    rig: RigFile, objects: ObjectsFile, rng: np.random.Generator, asked: PartCount = ONE_PART
) -> tuple[Placement, ...]:
    """Draw what lies on the table of an emulated rig; InputError if there is no room for so many parts.

    Several parts lie anywhere in the workspace if only `asked` says that there are several, and apart where
    the engine has no rule for parts that push each other.
    """
    assert rig.emulation is not None, "only emulated tables are drawn"
    parts: int | tuple[int, int] = rig.emulation.parts
    within, workspace = rig.emulation.placement_radius_mm, rig.workspace.radius_mm
    if parts == 1 and not asked.is_single:
        parts, within = asked.most if asked.exactly else (1, asked.most), workspace
    count = parts if isinstance(parts, int) else int(rng.integers(parts[0], parts[1] + 1))
    engine = None if rig.emulation.part is None else rig.emulation.part.engine
    gap_mm = (_APART_MM, math.inf) if engine == "quasi-static" and count > 1 else None
    return draw_placements(objects, count, within, rng, workspace, gap_mm)


def check_heights(rig: RigFile, objects: ObjectsFile) -> None:
    """Refuse a catalogue with an object that an arm's links would run into."""
    room_mm, name = lowest_links(rig)
    for model in objects.objects:
        top = max(state.top_mm for state in model.states)
        if top >= room_mm:
            raise InputError(
                f'object "{model.name}" is {top:g} mm high; the links of finger "{name}" pass '
                f"{room_mm:g} mm above the table (links_height_mm), so parts must be lower"
            )


def set_up(rig: RigFile, placements: Sequence[Placement], seed: int) -> BenchRig:
    """Start the emulated devices of an emulated rig in virtual time; leave a real rig's ports alone."""
    if rig.emulation is None:
        return BenchRig(rig, MonotonicClock(), str, (), None)
    mock = on_mock_wires(emulate(rig, placements, seed))
    return BenchRig(rig, mock.clock, mock.urls.__getitem__, tuple(placements), mock)


def emulated_table(bench: BenchRig, seed: int) -> ReferencePlacer | None:
    """Places references on an emulated bench's table; None for a real rig, where a person does."""
    return None if bench.mock is None else ReferencePlacer(bench.mock.rig.bench, seed)


def environment(
    bench: BenchRig,
    sink: RecordSink | None = None,
    latency_s: float | None = None,
    check: Callable[[], None] = lambda: None,
) -> Environment:
    """Environment of a run on a bench; with a sink, all that comes from clock and ports is recorded.

    `latency_s`: as `bus_latency_s` gave it, None to ask now. `check`: called in recorded calls, may raise.
    """
    latency_s = bus_latency_s(bench.rig) if latency_s is None else latency_s

    ports = FollowedPorts(SystemPlugs() if bench.mock is None else bench.mock)

    sharing = PortSharing(lambda port, baudrate: ports.open(bench.urls(port), baudrate))
    if sink is None:
        return Environment(bench.clock, sharing.open, latency_s, is_real=bench.mock is None)
    recorder = Recorder(bench.clock, sink, check)

    def open_recorded(port: str, baudrate: int) -> SerialBase:
        return recorder.open(port, lambda: sharing.open(port, baudrate))

    return Environment(recorder.clock, open_recorded, latency_s, recorder.check, bench.mock is None)


def connect(
    bench: BenchRig, sink: RecordSink | None = None, notice: Callable[[str], None] = lambda _: None
) -> Hand:
    """Open the ports and connect the hand, recorded as `environment` says.

    `notice` is called with what the operator should do now.
    """
    return environment(bench, sink).hand(bench.rig, notice)
