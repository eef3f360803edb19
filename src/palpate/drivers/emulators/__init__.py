"""Emulators of the devices at byte level: servos, arrays, and the mechanics between them.

They take the place of a real rig's hardware. Only rig's composition root and tests import them;
`docs/emulation.md` says what is modelled and what is not.
"""

from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.bench import Bench
from palpate.drivers.emulators.contact_source import EmulatedContactSource
from palpate.drivers.emulators.device_server import LOOPBACK, DeviceServer, serve_tcp
from palpate.drivers.emulators.finger import EmulatedFinger, SampledArray
from palpate.drivers.emulators.free_running import EmulatedFreeRunningArray, SharedWire
from palpate.drivers.emulators.mechanics import (
    ArmTruth,
    EmulatedStage,
    FingerTruth,
    JointCompliance,
    JointTruth,
)
from palpate.drivers.emulators.part import (
    GRAVITY_M_S2,
    IN_PLACE,
    Displacement,
    Displacements,
    FrictionSupport,
    Parts,
    PointForce,
    QuasiStaticPart,
    QuasiStaticParts,
    StillParts,
)
from palpate.drivers.emulators.pseudo_terminal import serve_pty
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.emulators.skin import Press, Skin
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.emulators.tip import PartSection, TipLoad, separation_mm
from palpate.drivers.emulators.usb_adapter import (
    AdapterTruth,
    HubStalls,
    PluggedPort,
    PortIntruder,
    UsbAdapter,
)
from palpate.drivers.emulators.wire_faults import (
    BootingBoard,
    FaultRates,
    FaultyWire,
    RatedFaultyWire,
    WireRates,
)

__all__ = [
    "GRAVITY_M_S2",
    "IN_PLACE",
    "LOOPBACK",
    "AdapterTruth",
    "ArmTruth",
    "Bench",
    "BootingBoard",
    "DeviceServer",
    "Displacement",
    "Displacements",
    "EmulatedArray",
    "EmulatedContactSource",
    "EmulatedFinger",
    "EmulatedFreeRunningArray",
    "EmulatedServo",
    "EmulatedStage",
    "FaultRates",
    "FaultyWire",
    "FingerTruth",
    "FrictionSupport",
    "HubStalls",
    "JointCompliance",
    "JointTruth",
    "PartSection",
    "Parts",
    "PluggedPort",
    "PointForce",
    "PortIntruder",
    "Press",
    "QuasiStaticPart",
    "QuasiStaticParts",
    "RatedFaultyWire",
    "SampledArray",
    "ServoChain",
    "SharedWire",
    "Skin",
    "StillParts",
    "Taxels",
    "TipLoad",
    "UsbAdapter",
    "WireRates",
    "separation_mm",
    "serve_pty",
    "serve_tcp",
]
