"""An emulated set-up in which faults are planted, as `palpate doctor` examines it.

The devices are behind wires in virtual time; the rig file names serial ports, which a stand-in for the system
opens. What the system says of them is in files below a folder.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import timedelta
from pathlib import Path
from typing import Any

from calibrations import MADE, empty_calibration
from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError
from palpate.config import RigFile, apply_calibration, load_rig, shipped_rig
from palpate.config.diagnosis_results import Cause, DoctorOut
from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.emulators.wire_faults import FaultyWire, RatedFaultyWire, WireRates
from palpate.rig.bench import BenchRig, connect, environment
from palpate.rig.calibrated_rig import RigOnBench
from palpate.rig.diagnostics.diagnosis import EmulatedOnlooker, diagnose, examine_directions
from palpate.rig.diagnostics.host_ports import Computer
from palpate.rig.diagnostics.servo_bus import BusEndpoint
from palpate.rig.diagnostics.steps import DiagnosisCase
from palpate.rig.emulated.devices import emulate, on_mock_wires
from palpate.rig.session.calibration_drift import devices_of

__all__ = ["BUS", "PORTS", "Change", "Fault", "Plant", "SetUp", "examined", "set_up_with"]

BUS, PORTS = "/dev/ttyUSB0", {"f1": "/dev/ttyUSB1", "f2": "/dev/ttyUSB2", "f3": "/dev/ttyUSB3"}


class SpoiledPlace(BusEndpoint):
    """A bus whose ports may be refused."""

    refused: Mapping[str, DeviceError] = {}

    def open(self, baudrate: int, *, shared: bool = False) -> SerialBase:
        """The bus's port, unless the system refuses it."""
        if self.port in self.refused:
            raise self.refused[self.port]
        return super().open(baudrate, shared=shared)

    def open_other(self, port: str, baudrate: int) -> SerialBase:
        """Another port likewise."""
        if port in self.refused:
            raise self.refused[port]
        return super().open_other(port, baudrate)


@dataclass
class SetUp:
    """A set-up that is well until something is planted: devices, wires, what opens ports, and the system."""

    built: RigFile
    described: RigFile
    bench: BenchRig
    wires: dict[str, FaultyWire]
    root: Path
    calibrated: bool
    refused: dict[str, DeviceError] = field(default_factory=dict)
    leads_to: dict[str, str] = field(default_factory=dict)
    age: timedelta = timedelta(days=1)
    devices: list[Any] = field(default_factory=list)

    @property
    def fingers(self) -> list[Any]:
        """The emulated fingers."""
        assert self.bench.emulated is not None
        return list(self.bench.emulated.bench.fingers)

    def servo(self, dxl_id: int) -> EmulatedServo:
        """The servo that was built with this id."""
        return self.servos()[[11, 12, 21, 22, 31, 32].index(dxl_id)]

    def servos(self) -> list[EmulatedServo]:
        """All of them, in the order of the rig file."""
        return [servo for finger in self.fingers for servo in finger.servos]

    def poke(self, dxl_id: int, item: str, value: int) -> None:
        """Change what a servo remembers, as somebody's earlier program may have done."""
        self.servo(dxl_id)._unit.table.set(item, value)

    def array(self, finger: int) -> EmulatedArray:
        """A finger's array."""
        found = self.fingers[finger].array
        assert isinstance(found, EmulatedArray)
        return found

    def skin(self, finger: int, **faults: Any) -> None:
        """Other taxels under a finger's array."""
        usual: dict[str, Any] = {"seed": 5, "noise_counts": 2.0, "offset_counts": 20.0, "gain_spread": 0.2}
        array = self.array(finger)
        array.taxels = Taxels(array.description, **usual | faults)

    def file(self, name: str, text: str) -> None:
        """A file of the system."""
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="ascii")

    def runs(self, number: int, program: str, *opened: str) -> None:
        """A process, and what it has open."""
        self.file(f"proc/{number}/comm", program)
        folder = self.root / f"proc/{number}/fd"
        folder.mkdir()
        for handle, port in enumerate(opened):
            (folder / str(handle)).symlink_to(port)

    def describe(self, change: Callable[[dict[str, Any]], None]) -> None:
        """Let the rig file say something else, or the devices be something else, than each other."""
        data = self.described.model_dump(mode="json", exclude_none=True)
        change(data)
        self.described = RigFile.model_validate(data)

    def on_bench(self) -> RigOnBench:
        """The rig file with serial ports, and its calibration."""
        plain = _on_serial_ports(self.described)
        if not self.calibrated:
            return RigOnBench(plain, plain, None, Path("rig.toml"))
        file = empty_calibration(plain, self.devices)
        return RigOnBench(apply_calibration(plain, file), plain, file, Path("rig.toml"))

    def place(self, rig: RigFile) -> BusEndpoint:
        """Where doctor finds the bus and all ports."""
        mock = {BUS: "mock://bus"} | {port: f"mock://{name}" for name, port in PORTS.items()} | self.leads_to
        found = SpoiledPlace(
            BUS,
            self.bench.clock,
            1e-3,
            rig.bus.baudrate_bps,
            rig,
            lambda port: self.bench.urls(mock[port]),
            self.bench,
        )
        object.__setattr__(found, "refused", self.refused)
        return found


def _on_serial_ports(rig: RigFile) -> RigFile:
    fingers = tuple(
        finger.model_copy(update={"array": finger.array.model_copy(update={"port": PORTS[finger.name]})})
        for finger in rig.fingers
    )
    return rig.model_copy(update={"bus": rig.bus.model_copy(update={"port": BUS}), "fingers": fingers})


Change = Callable[[dict[str, Any]], None]
Plant = Callable[[SetUp], None]


@dataclass(frozen=True)
class Fault:
    """A fault: how it is planted, where doctor has to find it, and by which cause.

    `build`: what is different in the devices that are built, beside the rig file. `causes`: any is right.
    """

    name: str
    causes: tuple[Cause, ...]
    device: str
    plant: Plant = lambda _: None
    build: Change = lambda _: None
    calibrated: bool = False
    move: bool = False


def set_up_with(fault: Fault, root: Path, seed: int = 3) -> SetUp:
    """A set-up that has run once, and then the fault in it."""
    described = load_rig(shipped_rig())
    data = described.model_dump(mode="json", exclude_none=True)
    fault.build(data)
    built = RigFile.model_validate(data)
    emulated = emulate(built, None, seed)
    wires: dict[str, FaultyWire] = {}
    for number, (port, (device, _)) in enumerate(emulated.devices.items()):
        kind = RatedFaultyWire if isinstance(device, ServoChain) else FaultyWire
        wires[port] = kind(device, seed + number, WireRates())
    devices = {port: (wires[port], rate) for port, (_, rate) in emulated.devices.items()}
    mock = on_mock_wires(replace(emulated, devices=devices))
    bench = BenchRig(built, mock.clock, mock.urls.__getitem__, None, mock)
    with connect(bench) as hand:
        hand.prepare()
        known = devices_of(hand)
    found = SetUp(built, described, bench, wires, root, fault.calibrated, devices=known)
    for number in range(4):
        found.file(f"sys/class/tty/ttyUSB{number}/device/latency_timer", "1\n")
        found.file(f"sys/class/tty/ttyUSB{number}/dev", f"188:{number}\n")
    fault.plant(found)
    return found


def examined(fault: Fault, root: Path, seed: int = 3) -> DoctorOut:
    """What doctor says of the set-up with this fault."""
    found = set_up_with(fault, root, seed)
    on_bench = found.on_bench()
    place = found.place(on_bench.described)
    case = DiagnosisCase(on_bench, place, Computer(root))

    def directions() -> Any:
        described = replace(found.bench, urls=place.urls)
        with environment(described).hand(on_bench.rig, lambda _: None) as hand:
            return examine_directions(hand, EmulatedOnlooker(found.bench))

    return diagnose(case, MADE + found.age, directions if fault.move else None)
