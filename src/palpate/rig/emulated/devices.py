"""Emulated devices, built from a rig file's `[emulation]` table. Called by the composition root only.

Builds the emulated servos, arrays, adapters and mechanics with their hidden truth, and puts them on
`mock://` wires in virtual time or hands them out to be served on real ports.
"""

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from palpate.base.errors import InputError
from palpate.config import EmulationConfig, FingerConfig, MountedArrayConfig, RigFile
from palpate.config.emulation import AdapterConfig
from palpate.config.rig_fingers import PALPATE_PROTOCOL
from palpate.config.rig_servos import ServoConfig
from palpate.drivers.dynamixel import BAUD_RATES
from palpate.drivers.emulators import (
    AdapterTruth,
    Bench,
    BootingBoard,
    EmulatedFinger,
    EmulatedServo,
    EmulatedStage,
    FaultRates,
    FaultyWire,
    HubStalls,
    PluggedPort,
    PortIntruder,
    RatedFaultyWire,
    SampledArray,
    ServoChain,
    SharedWire,
    Taxels,
    UsbAdapter,
    WireRates,
)
from palpate.drivers.tactile import Description, Shape
from palpate.drivers.transport import Device, MockHub, VirtualClock, connection_of
from palpate.rig.arrays import array_plugin, emulated_array
from palpate.rig.emulated.finger_truth import dead_taxels, draws_of, joint_truth, truth_of, with_yield
from palpate.rig.emulated.hidden_truth import (
    PartTruth,
    add_imperfections,
    draw_parts,
    draw_tip_friction,
    parts_of,
    start_postures,
    start_stage_rad,
)
from palpate.rig.emulated.scene import Placement
from palpate.rig.emulated.table import outlines_beside

Devices = Mapping[str, tuple[Device, int]]


def _attach_adapters(devices: Devices, rig: RigFile, seed: int) -> tuple[Devices, Mapping[str, str]]:
    """The devices by port behind the adapters that the rig file declares.

    Of the arrays' adapters one, drawn by the seed, is unplugged. An adapter that comes back under another
    name is among them under both: by the port's first name, the other one.
    """
    assert rig.emulation is not None
    found: dict[str, tuple[Device, int]] = {}
    renamed: dict[str, str] = {}
    chosen = 1 + int(np.random.default_rng([seed, 11]).integers(len(rig.fingers)))  # none without arrays
    for number, (port, (device, baudrate)) in enumerate(devices.items()):
        is_bus = port == rig.bus.port
        config = rig.emulation.bus_adapter if is_bus else rig.emulation.array_adapter
        if config is None:
            found[port] = (device, baudrate)
            continue
        rng = np.random.default_rng([seed, 9, number])
        truth = _adapter_truth(config, rng)
        if number not in (0, chosen):  # one array is enough
            truth = replace(truth, gone_s=None)
        adapter = UsbAdapter(device, baudrate, truth, int(rng.integers(2**32)))
        found[port] = (PluggedPort(adapter), baudrate)
        if truth.gone_s is not None and truth.renamed:
            renamed[port] = f"{port}-again"
            found[renamed[port]] = (PluggedPort(adapter, 1), baudrate)
    return found, renamed


def _adapter_truth(config: AdapterConfig, rng: np.random.Generator) -> AdapterTruth:
    """Adapter as a table declares it, with what the seed draws."""
    share = float(rng.uniform())
    gone = None
    if config.gone_after_s is not None:
        lo, hi = config.gone_after_s
        at = lo + share * (hi - lo)
        gone = (at, at + config.gone_for_s)
    stalls = None
    if config.stall_ms is not None:
        stalls = HubStalls(config.stall_ms[0] / 1e3, config.stall_ms[1] / 1e3, config.stall_every_s)
    return AdapterTruth(
        latency_s=config.latency_ms / 1e3,
        echoes=config.echoes,
        stalls=stalls,
        gone_s=gone,
        renamed=config.comes_back_as == "other",
        grab=PortIntruder(config.grabbed_s) if config.grabbed_s else None,
    )


_ROWS, _COLUMNS = 8, 20
_ROW_PITCH_MM = 2.0
_BALL_ROWS_SHARE = 0.9  # of a ball's height
_PAD_ROWS, _PAD_ROW_PITCH_MM = 4, 4.0
_MAX_COLUMNS = 255
_SOURCE_COLUMNS = 180  # of the skin whose load a contact source samples
_BIT_DEPTH = 12
_COUNTS_PER_N = 2000.0
_BOOT_TEXT = b"boot: palpate emulator\r\n"


@dataclass(frozen=True, eq=False)
class EmulatedRig:
    """Emulated devices by the port that the rig file names, with each wire's baud rate.

    `parts`: how each part on the table moves; empty if the rig file does not say. `renamed`: the names under
    which adapters come back that come back under another one, by the rig file's.
    """

    bench: Bench
    devices: Mapping[str, tuple[Device, int]]
    parts: tuple[PartTruth, ...] = ()
    renamed: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class MockRig:
    """An emulated rig on mock wires. `urls` maps the rig file's ports to ports that can be opened.

    The hub lives as long as this value does, and the ports with it.
    """

    rig: EmulatedRig
    hub: MockHub
    clock: VirtualClock
    urls: Mapping[str, str]

    def adapter_of(self, url: str) -> str | None:
        """The port, as the rig file names it, whose adapter is at a URL now: these are `Plugs`."""
        port = next((port for port, at in self.urls.items() if at == url), None)
        first = {name: port for port, name in self.rig.renamed.items()}.get(port or "", port)
        return first if port is not None and self._is_there(port) else None

    def port_of(self, adapter: object) -> str | None:
        """The URL at which the adapter of one of the rig file's ports is now."""
        names = [str(adapter), self.rig.renamed.get(str(adapter), "")]
        return next((self.urls[name] for name in names if name in self.urls and self._is_there(name)), None)

    def _is_there(self, port: str) -> bool:
        device, _ = self.rig.devices[port]
        return not isinstance(device, PluggedPort) or device.is_there(self.clock.now())


def emulate(rig: RigFile, placements: Sequence[Placement], seed: int) -> EmulatedRig:
    """Build the emulated devices of `rig` round what lies on the table; same seed, same devices.

    Raises InputError if the rig file has no `[emulation]` table, or as `parts_of` does.
    """
    if rig.emulation is None:
        raise InputError(
            f'rig "{rig.name}" describes real devices; '
            "add an [emulation] table and mock:// ports to emulate it"
        )
    # The catalogue's draw and the devices' draws must not depend on each other's number.
    rng = np.random.default_rng([seed, 1])
    fingers: list[EmulatedFinger] = []
    bench_of: list[Bench] = []

    def advance(now: float) -> None:
        bench_of[0].advance(now)

    turned = start_stage_rad(rig, np.random.default_rng([seed, 15]))
    stage, truths = _stage(rig, turned, seed), draw_parts(rig.emulation.part, placements, seed)
    parts = parts_of(truths, placements)
    tip_friction = draw_tip_friction(rig.emulation.part, seed)
    postures = start_postures(rig, placements, turned, np.random.default_rng([seed, 14]))
    for index, finger in enumerate(rig.fingers):
        newer = np.random.default_rng([seed, 4, index])
        truth = truth_of(finger, rig.emulation, rng, newer)
        truth = with_yield(truth, finger, rig.emulation, np.random.default_rng([seed, 8, index]))
        truth = draws_of(finger, rig.emulation).with_cables(truth, np.random.default_rng([seed, 12, index]))
        description = description_of(finger, seed)
        near, far = (
            _servo(rig, servo, start)
            for servo, start in zip(finger.servos.values(), postures[index], strict=True)
        )
        taxels = Taxels(
            description,
            seed=int(rng.integers(2**63)),
            noise_counts=rig.emulation.noise_counts,
            gain_spread=rig.emulation.gain_spread,
            offset_counts=rig.emulation.offset_counts,
            crosstalk=rig.emulation.crosstalk,
            drift_counts_per_s=rig.emulation.drift_counts_per_s,
            lag_s=rig.emulation.lag_s * float(np.random.default_rng([seed, 17, index]).uniform()),
            dead=dead_taxels(description, rig.emulation.dead_taxels, newer),
        )
        array = emulated_array(finger, taxels, advance)
        beside = truth.height_mm, truth.half_length_mm, truth.tip_radius_mm, truth.shape
        outlines = outlines_beside(placements, parts, *beside)
        fingers.append(EmulatedFinger(truth, (near, far), array, outlines, stage, tip_friction))
    bench = Bench(fingers, stage, parts)
    bench_of.append(bench)
    add_imperfections(bench, rig, seed)
    chain = ServoChain(bench.servos, advance, baudrate=rig.bus.baudrate_bps)
    devices: dict[str, tuple[Device, int]] = {rig.bus.port: (chain, rig.bus.baudrate_bps)}
    reset_s = _reset_s(rig, seed)
    connections: dict[str, list[tuple[FingerConfig, SampledArray]]] = {}
    for finger, emulated in zip(rig.fingers, fingers, strict=True):
        if finger.array.has_device:
            there = connections.setdefault(connection_of(finger.array.port), [])
            there.append((finger, emulated.array))
    for port, there in connections.items():
        devices[port] = (_connection(there, rig.emulation, reset_s), there[-1][0].array.baudrate_bps)
    on_wires, renamed = _attach_adapters(_on_bad_wires(devices, rig.emulation, seed), rig, seed)
    return EmulatedRig(bench, on_wires, truths, renamed)


def _on_bad_wires(
    devices: Mapping[str, tuple[Device, int]], emulation: EmulationConfig, seed: int
) -> Mapping[str, tuple[Device, int]]:
    """The devices behind wires that flip bits and lose packets as often as the rig file says."""
    rates = FaultRates(flipped=emulation.flipped_bytes, lost=emulation.lost_packets)
    if rates == FaultRates():
        return devices
    found: dict[str, tuple[Device, int]] = {}
    for number, (port, (device, baudrate)) in enumerate(devices.items()):
        seeds = int(np.random.default_rng([seed, 3, number]).integers(2**32))
        both = WireRates(rates, rates)
        if isinstance(device, ServoChain):
            found[port] = (RatedFaultyWire(device, seeds, both), baudrate)
        else:
            found[port] = (FaultyWire(device, seeds, both), baudrate)
    return found


def on_mock_wires(rig: EmulatedRig) -> MockRig:
    """Put the devices on in-process wires in virtual time."""
    clock = VirtualClock()
    hub = MockHub(clock)
    urls = {
        port: hub.attach(port.partition("://")[2].replace("/", "-"), device, baudrate)
        for port, (device, baudrate) in rig.devices.items()
    }
    return MockRig(rig, hub, clock, urls)


def _stage(rig: RigFile, start_rad: float, seed: int) -> EmulatedStage | None:
    """The emulated stage, at an angle as far as people can tell; its draw leaves the fingers' as they are."""
    if rig.stage is None or rig.emulation is None:
        return None
    spec, rng = rig.stage, np.random.default_rng([seed, 2])
    joint = joint_truth(spec.gear_ratio, spec.zero_deg, rig.emulation.stage_backlash_deg, rng)
    start = joint.zero_rad + spec.gear_ratio * start_rad
    off = math.radians(rig.emulation.stage_error_deg) * rng.uniform(-1, 1)
    joint = replace(joint, zero_rad=joint.zero_rad - spec.gear_ratio * off)
    # The centre's error came later: a seed keeps what it has drawn before.
    away = rig.emulation.stage_centre_error_mm * math.sqrt(rng.uniform())
    bearing = rng.uniform(0, 2 * math.pi)
    x, y = spec.centre_mm
    centre = x + away * math.cos(bearing), y + away * math.sin(bearing)
    return EmulatedStage(centre, joint, _servo(rig, spec, start))


def _servo(rig: RigFile, spec: ServoConfig, start_rad: float) -> EmulatedServo:
    """A servo that is set to the bus's baud rate and the Homing Offset of the rig file."""
    return EmulatedServo(
        spec.dxl_id,
        model=spec.model,
        start_rad=start_rad,
        baud_rate_code=BAUD_RATES.index(rig.bus.baudrate_bps),
        homing_offset=spec.homing_offset,
    )


def _reset_s(rig: RigFile, seed: int) -> Mapping[str, float]:
    """Finger whose array resets by itself, and when."""
    if rig.emulation is None or rig.emulation.array_reset_s is None:
        return {}
    rng = np.random.default_rng([seed, 10])
    finger = rig.fingers[int(rng.integers(len(rig.fingers)))]
    return {finger.name: float(rng.uniform(*rig.emulation.array_reset_s))}


def _connection(
    there: Sequence[tuple[FingerConfig, SampledArray]],
    emulation: EmulationConfig,
    reset_s: Mapping[str, float],
) -> Device:
    """Device of a connection: an array, a board that carries all of them, or several that send in turns."""
    arrays = [(array, reset_s.get(spec.name)) for spec, array in there]
    protocol = there[0][0].array.protocol
    board = array_plugin(protocol).board if len(arrays) > 1 else None
    if board is not None and all(spec.array.protocol == protocol for spec, _ in there):
        resets = [each for _, each in arrays if each is not None]
        arrays = [(board([array for array, _ in arrays]), min(resets, default=None))]
    boards = [_board(array, emulation, each) for array, each in arrays]
    return boards[0] if len(boards) == 1 else SharedWire(boards)


def _board(array: SampledArray, emulation: EmulationConfig, reset_s: float | None) -> Device:
    """Board that the array's port leads to."""
    if emulation.array_boot_s == 0 and reset_s is None:
        return array
    return BootingBoard(
        array,
        emulation.array_boot_s,
        array.restart,
        _BOOT_TEXT,
        reset_s=reset_s,
        has_dtr=emulation.array_boot_s > 0,
    )


def _columns(finger: FingerConfig) -> int:
    """Number of columns round the tip."""
    return _SOURCE_COLUMNS if finger.array.reports_contacts else _COLUMNS


def _column_pitch_mm(finger: FingerConfig) -> float:
    """Distance of columns round the tip; in whole 1/100 mm where the array can only tell these."""
    pitch = math.radians(finger.array.coverage_deg) * finger.tip.radius_mm / _columns(finger)
    return round(pitch, 2) if isinstance(finger.array, MountedArrayConfig) else pitch


def _row_pitch_mm(finger: FingerConfig) -> float:
    """Distance of rows up the tip; those of a ball reach to where it may touch, and a little beyond."""
    if finger.tip.kind.is_upright:
        return _ROW_PITCH_MM
    pitch = _BALL_ROWS_SHARE * 2 * finger.tip.radius_mm / _ROWS
    return round(pitch, 2) if isinstance(finger.array, MountedArrayConfig) else pitch


def description_of(finger: FingerConfig, seed: int) -> Description:
    """Description of an emulated array: 8 rows of 20 taxels over its part of the tip's circumference.

    Another seed is another array, and its id tells.
    """
    if finger.tip.kind.has_face:
        return _pad_description(finger, seed)
    per_n = _COUNTS_PER_N
    if isinstance(finger.array, MountedArrayConfig):
        per_n = finger.array.counts_per_n
        if finger.array.shape == "flat":
            raise InputError(f"finger {finger.name}: flat arrays cannot be emulated; leave array.shape out")
    pitch = _column_pitch_mm(finger) / finger.tip.radius_mm
    columns = _even_places(_columns(finger), pitch)
    return replace(
        _flat_description(finger, seed, per_n, columns, (_ROWS, _row_pitch_mm(finger))),
        shape=Shape.CYLINDER,
        tip_radius_mm=finger.tip.radius_mm,
    )


def _pad_description(finger: FingerConfig, seed: int) -> Description:
    """The same of a pad's flat array, whose columns cover just the face, no further apart than pitch_mm.

    However wide the face may be, by its bound.
    """
    width, pitch = 2 * (finger.tip.radius_mm + finger.tip.radius_bound_mm), finger.array.pitch_mm or math.inf
    if isinstance(finger.array, MountedArrayConfig):
        raise InputError(
            f"finger {finger.name}: emulated pads have arrays that describe themselves; "
            f'use protocol "{PALPATE_PROTOCOL}"'
        )
    count = max(math.ceil(width / pitch - 1e-9), 2)
    if count > _MAX_COLUMNS:
        raise InputError(
            f"finger {finger.name}: a face of {width:g} mm has {count} columns {pitch:g} mm apart; "
            f"an emulated array has at most {_MAX_COLUMNS}: raise array.pitch_mm"
        )
    columns = _even_places(count, width / count)
    row_pitch_mm = max(_PAD_ROW_PITCH_MM, (finger.tip.length_mm or 0.0) / _PAD_ROWS)
    return _flat_description(finger, seed, _COUNTS_PER_N, columns, (_PAD_ROWS, row_pitch_mm))


def _even_places(count: int, pitch: float) -> tuple[float, ...]:
    """So many places, so far apart, around 0."""
    return tuple((k - (count - 1) / 2) * pitch for k in range(count))


def _flat_description(
    finger: FingerConfig, seed: int, per_n: float, columns: tuple[float, ...], rows: tuple[int, float]
) -> Description:
    """An emulated array that is flat; `rows`: how many, and how far apart (mm)."""
    count, row_pitch_mm = rows
    return Description(
        unique_id=_unique_id(finger, seed),
        firmware="palpate emulator 1",
        emulated=True,
        shape=Shape.FLAT,
        rows=count,
        cols=len(columns),
        bit_depth=_BIT_DEPTH,
        max_rate_hz=1000.0,
        full_scale_n=(2**_BIT_DEPTH - 1) / per_n,
        counts_per_n=per_n,
        tip_radius_mm=0.0,
        columns=columns,
        row_heights_mm=tuple((k + 0.5) * row_pitch_mm for k in range(count)),
    )


def _unique_id(finger: FingerConfig, seed: int) -> bytes:
    name = finger.name.encode()
    return name[:8].ljust(8, b"\0") + hashlib.sha256(b"%d %s" % (seed, name)).digest()[:8]
