"""Planted faults and what the doctor must say of them."""

import errno
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import timedelta
from pathlib import Path
from typing import Any

from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError
from palpate.config import RigFile, RigOnBench, apply_calibration, load_rig, shipped_rig
from palpate.config.diagnosis_results import Cause, CheckOut, DoctorOut
from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.emulators.wire_faults import FaultRates, FaultyWire, RatedFaultyWire, WireRates
from palpate.drivers.tactile.messages import SelfTestResult
from palpate.drivers.transport.ports import PortForbidden, PortMissing, PortTaken
from palpate.jobs.check import WiringCheck
from palpate.rig.bench import BenchRig, connect
from palpate.rig.diagnostics.diagnosis import check_out, diagnose, doctor_out
from palpate.rig.diagnostics.host_ports import Computer
from palpate.rig.diagnostics.servo_bus import BusEndpoint
from palpate.rig.diagnostics.steps import CHECK_LISTEN_S, DiagnosisCase
from palpate.rig.diagnostics.wiring_check import EmulatedOnlooker
from palpate.rig.emulated.devices import emulate, on_mock_wires
from palpate.rig.session.calibration_drift import devices_of
from support.benches.calibration_files import MADE, empty_calibration, full_calibration
from support.devices.spoilt_taxels import Spoil, drop_rows, hold, interference, loose, spoil

# ----------------------------------------------------------------------------------------------------
# An emulated set-up in which faults are planted, as `palpate doctor` examines it.
#
# The devices are behind wires in virtual time; the rig file names serial ports, which a stand-in for the
# system opens. What the system says of them is in files below a folder.

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
    without_bounds: bool = False
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
        bounds = {} if self.without_bounds else {"bounds": full_calibration(plain).fingers[0].bounds}
        file = empty_calibration(plain, self.devices)
        fingers = [item.model_copy(update=bounds) for item in file.fingers]
        file = file.model_copy(update={"fingers": fingers})
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

    `build`: what is different in the devices that are built, beside the rig file.
    """

    name: str
    cause: Cause | None
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
    emulated = emulate(built, (), seed)
    wires: dict[str, FaultyWire] = {}
    for number, (port, (device, _)) in enumerate(emulated.devices.items()):
        kind = RatedFaultyWire if isinstance(device, ServoChain) else FaultyWire
        wires[port] = kind(device, seed + number, WireRates())
    devices = {port: (wires[port], rate) for port, (_, rate) in emulated.devices.items()}
    mock = on_mock_wires(replace(emulated, devices=devices))
    bench = BenchRig(built, mock.clock, mock.urls.__getitem__, (), mock)
    with connect(bench) as hand:
        hand.prepare()
        known = devices_of(hand)
    found = SetUp(built, described, bench, wires, root, fault.calibrated, devices=known)
    for number in range(4):
        found.file(f"sys/class/tty/ttyUSB{number}/device/latency_timer", "1\n")
        found.file(f"sys/class/tty/ttyUSB{number}/dev", f"188:{number}\n")
    fault.plant(found)
    return found


def checked(rig: RigFile, place: BusEndpoint) -> CheckOut:
    """What a check says of a rig without a calibration, on a computer of which nothing is known."""
    on_bench = RigOnBench(rig, rig, None, Path("rig.toml"))
    case = DiagnosisCase(on_bench, place, Computer(Path("/no/such/root")), listen_s=CHECK_LISTEN_S)
    return check_out(diagnose(case, MADE))


def examined(fault: Fault, root: Path, seed: int = 3) -> DoctorOut:
    """What doctor says of the set-up with this fault."""
    found = set_up_with(fault, root, seed)
    on_bench = found.on_bench()
    place = found.place(on_bench.described)
    case = DiagnosisCase(on_bench, place, Computer(root))
    wiring = WiringCheck(press=False, move=fault.move, onlooker=EmulatedOnlooker(found.bench))
    return doctor_out(diagnose(case, MADE + found.age, [wiring.step(case, lambda: None)]))


# ----------------------------------------------------------------------------------------------------
# Faults of a set-up, each planted alone, and the cause that `palpate doctor` has to name for it.


def _refuse(port: str, kind: type[DeviceError], number: int) -> Plant:
    def plant(found: SetUp) -> None:
        found.refused[port] = kind(f"port {port}: {errno.errorcode[number]}")

    return plant


def _modem_manager_has(found: SetUp) -> None:
    found.refused[BUS] = PortTaken(f"port {BUS} is in use")
    found.runs(812, "ModemManager", "/dev/null", BUS)


def _modem_manager_may(found: SetUp) -> None:
    found.runs(812, "ModemManager")
    found.file("run/udev/data/c188:1", "S:serial/by-id/usb-x\nE:ID_MM_CANDIDATE=1\n")


def _shared(found: SetUp) -> None:
    found.runs(977, "python3", PORTS["f2"])


def _brltty(found: SetUp) -> None:
    found.refused[PORTS["f2"]] = PortMissing("gone")
    found.runs(650, "brltty")
    found.file("sys/bus/usb/devices/1-2/idVendor", "1a86\n")
    found.file("sys/bus/usb/devices/1-2/idProduct", "7523\n")
    found.file("sys/bus/usb/devices/1-3/idVendor", "0403\n")
    found.file("sys/bus/usb/devices/1-3/idProduct", "6001\n")
    (found.root / "sys/bus/usb/devices/1-3:1.0/ttyUSB0").mkdir(parents=True)


def _poke(dxl_id: int, item: str, value: int) -> Plant:
    return lambda found: found.poke(dxl_id, item, value)


def _all_servos(deed: Callable[[EmulatedServo], object]) -> Plant:
    def plant(found: SetUp) -> None:
        for servo in found.servos():
            deed(servo)
        found.bench.clock.sleep(0.5)

    return plant


def _one_servo(dxl_id: int, deed: Callable[[EmulatedServo], object]) -> Plant:
    def plant(found: SetUp) -> None:
        deed(found.servo(dxl_id))
        found.bench.clock.sleep(0.5)

    return plant


def _old_firmware(servo: EmulatedServo) -> None:
    servo._inner = EmulatedServo(servo.dxl_id, firmware=37, start_rad=servo.shaft_rad)._inner


def _one_more(found: SetUp) -> None:
    wire = found.wires["mock://bus"]
    wire._device._servos.append(EmulatedServo(90))  # type: ignore[attr-defined]


def _both_off(found: SetUp) -> None:
    for dxl_id in (31, 32):
        found.servo(dxl_id).power_off()


def _bus_wire(rates: FaultRates) -> Plant:
    def plant(found: SetUp) -> None:
        found.wires["mock://bus"].rates = WireRates(rates, rates)

    return plant


def _array_wire(name: str, rates: FaultRates) -> Plant:
    def plant(found: SetUp) -> None:
        found.wires[f"mock://{name}"].rates = WireRates(FaultRates(lost=rates.lost >= 1), rates)

    return plant


def _skin(finger: int, **faults: Any) -> Plant:
    return lambda found: found.skin(finger, **faults)


def _spoilt(how: Spoil) -> Plant:
    """Array f2's counts are spoilt before they are sent."""
    return lambda found: spoil(found.array(1), how)


def _says(**fields: Any) -> Plant:
    """Array f2 says something else of itself."""

    def plant(found: SetUp) -> None:
        array = found.array(1)
        array.description = replace(array.description, **fields)

    return plant


def _broken(part: SelfTestResult) -> Plant:
    def plant(found: SetUp) -> None:
        found.array(1).broken = part

    return plant


def _describe(change: Change) -> Plant:
    return lambda found: found.describe(change)


def _finger(number: int, table: str, **keys: Any) -> Change:
    def change(data: dict[str, Any]) -> None:
        data["fingers"][number][table] |= keys

    return change


def _slow_touch(data: dict[str, Any]) -> None:
    data["closing"]["touch_speed_mm_s"] = 0.3


def _bus_rate(data: dict[str, Any]) -> None:
    data["bus"]["baudrate_bps"] = 57_600


def _weiss(number: int) -> Change:
    return _finger(number, "array", protocol="weiss-wts", counts_per_n=2000.0)


def _calibrated_with(rows: int, cols: int) -> Plant:
    taxels = {"gain": [[1.0] * cols] * rows, "gain_bound": [[0.02] * cols] * rows, "noise_counts": 2.0}
    taxels |= {"crosstalk": 0.06, "crosstalk_bound": 0.004}
    return _describe(_finger(1, "array", taxels=taxels))


def _swap(found: SetUp) -> None:
    found.leads_to |= {PORTS["f1"]: "mock://f2", PORTS["f2"]: "mock://f1"}


def _replaced(found: SetUp) -> None:
    array = found.array(1)
    array.description = replace(array.description, unique_id=bytes(16))


def _quick_touch(data: dict[str, Any]) -> None:
    data["closing"]["touch_speed_mm_s"] = 8.0


def _without_bounds(found: SetUp) -> None:
    found.without_bounds = True


def _old_calibration(found: SetUp) -> None:
    found.age = timedelta(days=400)


def _off_zero(found: SetUp) -> None:
    found.describe(_finger(1, "slide", zero_mm=25.0))


_COLUMN = [(row, 7) for row in range(8)]
_ROW = [(3, col) for col in range(20)]

WELL = (
    Fault("nothing", None, ""),
    Fault("nothing, calibrated", None, "", calibrated=True),
    Fault("nothing, and joints are moved", None, "", move=True),
)
"""Set-ups without a fault."""

FAULTS = (
    Fault(
        "the bus's adapter is not plugged in",
        Cause.PORT_MISSING,
        BUS,
        _refuse(BUS, PortMissing, errno.ENOENT),
    ),
    Fault(
        "an array's port is not there",
        Cause.PORT_MISSING,
        PORTS["f3"],
        _refuse(PORTS["f3"], PortMissing, errno.ENODEV),
    ),
    Fault(
        "user not in the ports' group", Cause.PORT_FORBIDDEN, BUS, _refuse(BUS, PortForbidden, errno.EACCES)
    ),
    Fault("another program holds the bus", Cause.PORT_BUSY, BUS, _refuse(BUS, PortTaken, errno.EBUSY)),
    Fault("another program has an array's port open, too", Cause.PORT_BUSY, PORTS["f2"], _shared),
    Fault("ModemManager holds the bus", Cause.MODEM_MANAGER, BUS, _modem_manager_has),
    Fault("ModemManager may probe an array", Cause.MODEM_MANAGER, PORTS["f1"], _modem_manager_may),
    Fault("brltty took an array's adapter", Cause.BRLTTY, PORTS["f2"], _brltty),
    Fault(
        "latency timer of 16 ms",
        Cause.LATENCY_TIMER,
        BUS,
        lambda s: s.file("sys/class/tty/ttyUSB0/device/latency_timer", "16"),
    ),
    Fault("a servo at another baud rate", Cause.BAUD_RATE, "21", _poke(21, "Baud Rate", 1)),
    Fault("all servos at another baud rate", Cause.BAUD_RATE, "all servos", build=_bus_rate),
    Fault("a servo with another id", Cause.WRONG_ID, "22", _poke(22, "ID", 1)),
    Fault(
        "a finger that unstopped breaks its tip",
        Cause.TOUCH_TOO_HARD,
        "finger f1",
        _describe(_finger(0, "tip", bears_n=20.0)),
    ),
    Fault("two servos of one id", Cause.DUPLICATE_ID, "11", _poke(12, "ID", 11)),
    Fault(
        "a servo of another model", Cause.WRONG_MODEL, "31", _describe(_finger(2, "aim", model="XC330-M288"))
    ),
    Fault("servos without power", Cause.BUS_SILENT, BUS, _all_servos(EmulatedServo.power_off)),
    Fault("a servo's plug is out", Cause.SERVO_SILENT, "12", _one_servo(12, EmulatedServo.power_off)),
    Fault("a cable to two servos is out", Cause.SERVO_SILENT, "31", _both_off),
    Fault("a servo with old firmware", Cause.SERVO_FIRMWARE, "21", _one_servo(21, _old_firmware)),
    Fault("supply too low", Cause.SUPPLY_LOW, "servos", _all_servos(lambda s: s.set_supply(8.0))),
    Fault("supply too high", Cause.SUPPLY_HIGH, "servos", _all_servos(lambda s: s.set_supply(17.0))),
    Fault(
        "a bad cable: less voltage at one servo",
        Cause.SUPPLY_DROP,
        "32",
        _one_servo(32, lambda s: s.set_supply(10.5)),
    ),
    Fault(
        "overload latched",
        Cause.HARDWARE_ERROR,
        "11",
        _one_servo(11, lambda s: s.report_hardware_error(0x20)),
    ),
    Fault("a servo too hot", Cause.TOO_HOT, "22", _one_servo(22, lambda s: s.set_temperature(90.0))),
    Fault("a warm servo", Cause.WARM, "22", _one_servo(22, lambda s: s.set_temperature(75.0))),
    Fault("torque left on", Cause.TORQUE_ON, "12", _one_servo(12, lambda s: s._unit.set_torque(on=True))),
    Fault("limits not set", Cause.LIMITS_NOT_SET, "32", _poke(32, "Current Limit", 1193)),
    Fault(
        "a range that a servo cannot keep",
        Cause.LIMITS_IMPOSSIBLE,
        "21",
        _describe(_finger(1, "aim", zero_deg=270.0)),
    ),
    Fault("a drive mode reversed", Cause.DRIVE_REVERSED, "11", _poke(11, "Drive Mode", 1)),
    Fault("a homing offset", Cause.HOMING_OFFSET, "21", _poke(21, "Homing Offset", 300)),
    Fault(
        "a secondary id that is another servo's", Cause.SHADOW_ID, "11", _poke(11, "Secondary(Shadow) ID", 21)
    ),
    Fault("protection switched off", Cause.PROTECTION_OFF, "12", _poke(12, "Shutdown", 0)),
    Fault("a velocity limit of another program", Cause.LIMITS_NOT_SET, "12", _poke(12, "Velocity Limit", 5)),
    Fault("torque on at power-up", Cause.LIMITS_NOT_SET, "12", _poke(12, "Startup Configuration", 1)),
    Fault("a weak servo", Cause.FOREIGN_SETTING, "11", _poke(11, "PWM Limit", 100)),
    Fault(
        "a voltage limit below the supply", Cause.FOREIGN_SETTING, "21", _poke(21, "Max Voltage Limit", 115)
    ),
    Fault(
        "a low temperature limit",
        Cause.FOREIGN_SETTING,
        "22",
        _poke(22, "Temperature Limit", 25),
    ),
    Fault("a servo at 4.5 Mbps", Cause.BAUD_RATE, "31", _poke(31, "Baud Rate", 7)),
    Fault("a servo that no file knows", Cause.FOREIGN_SERVO, "servo 90", _one_more),
    Fault("bits flip on the bus", Cause.BUS_LOSSY, "bus", _bus_wire(FaultRates(flipped=0.001))),
    Fault("packets get lost on the bus", Cause.BUS_LOSSY, "bus", _bus_wire(FaultRates(lost=0.02))),
    Fault("a slide's zero is off", Cause.ZERO_OFF, "f2", _off_zero),
    Fault(
        "a joint goes the other way",
        Cause.DIRECTION_WRONG,
        "21",
        _describe(_finger(1, "aim", gear_ratio=-5.0)),
        move=True,
    ),
    Fault("an array is silent", Cause.ARRAY_SILENT, "f2", _array_wire("f2", FaultRates(lost=1.0))),
    Fault(
        "an array at another baud rate",
        Cause.ARRAY_BAUD_RATE,
        "f2",
        build=_finger(1, "array", baudrate_bps=115_200),
    ),
    Fault("an array of another protocol", Cause.ARRAY_PROTOCOL, "f2", build=_weiss(1)),
    Fault("a rig file that names another protocol", Cause.ARRAY_PROTOCOL, "f2", _describe(_weiss(1))),
    Fault("an array for another tip", Cause.ARRAY_GEOMETRY, "f2", build=_finger(1, "tip", radius_mm=8.0)),
    Fault(
        "an array that covers less", Cause.ARRAY_GEOMETRY, "f2", build=_finger(1, "array", coverage_deg=180.0)
    ),
    Fault("an array of other rows and columns", Cause.ARRAY_GEOMETRY, "f2", _calibrated_with(4, 10)),
    Fault("a dead column", Cause.DEAD_COLUMN, "f2", _skin(1, dead=_COLUMN)),
    Fault("a dead row", Cause.DEAD_ROW, "f2", _skin(1, dead=_ROW)),
    Fault("a dead taxel", Cause.DEAD_TAXEL, "f2", _skin(1, dead=[(2, 3)])),
    Fault("a hot taxel", Cause.HOT_TAXEL, "f2", _skin(1, hot=[(2, 3)])),
    Fault("an array with a broken supply", Cause.ARRAY_HARDWARE, "f2", _broken(SelfTestResult.SUPPLY)),
    Fault("frames get lost", Cause.FRAMES_LOST, "f2", _array_wire("f2", FaultRates(lost=0.03))),
    Fault("too much noise", Cause.NOISE, "f2", _skin(1, noise_counts=60.0)),
    Fault("samples that are sent again", Cause.FRAMES_REPEATED, "f2", _spoilt(hold(30.0))),
    Fault("an array that hangs", Cause.ARRAY_HUNG, "f2", _spoilt(hold(1e4, until_s=0.0))),
    Fault("interference", Cause.INTERFERENCE, "f2", _spoilt(interference(30.0))),
    Fault("rows that drop", Cause.UNSTEADY_ROW, "f2", _spoilt(drop_rows(0.05))),
    Fault("a taxel that is loose", Cause.UNSTEADY_TAXEL, "f2", _spoilt(loose(0.01))),
    Fault("zeros that drift", Cause.DRIFT, "f2", _skin(1, drift_counts_per_s=5.0)),
    Fault("a force scale off by ten", Cause.FORCE_SCALE, "f2", _says(counts_per_n=20_000.0)),
    Fault("touches harder than parts bear", Cause.TOUCH_TOO_HARD, "touches", _describe(_quick_touch)),
    Fault(
        "a calibration without bounds", Cause.BOUNDS_MISSING, "calibration", _without_bounds, calibrated=True
    ),
    Fault("two arrays' cables exchanged", Cause.ARRAYS_SWAPPED, "f1", _swap, calibrated=True),
    Fault(
        "an array replaced since calibration", Cause.OTHER_DEVICES, "calibration", _replaced, calibrated=True
    ),
    Fault("an old calibration", Cause.CALIBRATION_OLD, "calibration", _old_calibration, calibrated=True),
    Fault("a touch slower than a slide can go", Cause.LIMITS_IMPOSSIBLE, "22", _describe(_slow_touch)),
)
"""Each with the one cause that explains it."""
