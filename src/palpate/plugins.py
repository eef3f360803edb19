"""What the author of a plug-in imports, and the plug-ins that come with palpate.

`docs/adding-a-device.md` explains the parts, `examples/array_plugin` is a distribution with a plug-in, and
`palpate.testing` holds the checks that a plug-in has to pass.
"""

from palpate.base.errors import DeviceError, InputError, printable
from palpate.base.geometry import Counts, Floats
from palpate.config import ArrayConfig, MountedArrayConfig
from palpate.drivers.dynamixel.emanual_tables import COMMON_ITEMS, Access, Area, TableItem
from palpate.drivers.dynamixel.specifications import MotorConstants, ServoSpecification
from palpate.drivers.dynamixel.x_series import table_of
from palpate.drivers.emulators.bench import SampledArray
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.description import Description, Shape
from palpate.drivers.tactile.frame_times import FrameTimes
from palpate.drivers.tactile.frames import ArrayCounters, ArrayDriver, TactileFrame
from palpate.drivers.tactile.mounting import Corner, Mounting
from palpate.drivers.tactile.stream import FrameStream, Port
from palpate.drivers.tactile.streamed_array import StreamedArray
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.wire import Device, Emission, wire_time_s
from palpate.rig.arrays import ArrayPlugin
from palpate.rig.conversion import mounting_of

__all__ = [
    "COMMON_ITEMS",
    "Access",
    "Area",
    "ArrayConfig",
    "ArrayCounters",
    "ArrayDriver",
    "ArrayPlugin",
    "Clock",
    "Corner",
    "Counts",
    "Description",
    "Device",
    "DeviceError",
    "Emission",
    "Floats",
    "FrameStream",
    "FrameTimes",
    "InputError",
    "MotorConstants",
    "MountedArrayConfig",
    "Mounting",
    "Port",
    "SampledArray",
    "ServoSpecification",
    "Shape",
    "StreamedArray",
    "TableItem",
    "TactileFrame",
    "Taxels",
    "mounting_of",
    "printable",
    "table_of",
    "wire_time_s",
]
