"""Names that authors of plug-ins import, and the list of plug-ins that come with palpate.

`docs/adding-a-device.md` explains the parts, `examples/array_plugin` is a distribution with a plug-in, and
`palpate.testing` holds the checks that a plug-in has to pass.
"""

from palpate.base.errors import DeviceError, InputError, printable_text
from palpate.base.geometry import Counts, Floats
from palpate.config import (
    ArrayConfig,
    ContactSourceConfig,
    FreeRunningArrayConfig,
    MountedArrayConfig,
    WrappedArrayConfig,
)
from palpate.drivers.dynamixel import (
    COMMON_ITEMS,
    Access,
    Area,
    MotorConstants,
    ServoSpecification,
    TableItem,
    table_of,
)
from palpate.drivers.emulators import EmulatedFreeRunningArray, SampledArray, Taxels
from palpate.drivers.tactile import (
    ArrayCounters,
    ArrayDriver,
    ContactReading,
    Corner,
    DecodedFrame,
    Description,
    FrameDecoder,
    FrameStream,
    FrameTimes,
    FreeRunningArray,
    Mounting,
    Port,
    Shape,
    StreamedArray,
    TactileFrame,
    source_description,
    source_frame,
)
from palpate.drivers.transport import Clock, Device, Emission, wire_time_s
from palpate.rig.arrays import ArrayPlugin
from palpate.rig.conversion import check_cells, first_corner, mounting_of, wrapped_description

__all__ = [
    "COMMON_ITEMS",
    "Access",
    "Area",
    "ArrayConfig",
    "ArrayCounters",
    "ArrayDriver",
    "ArrayPlugin",
    "Clock",
    "ContactReading",
    "ContactSourceConfig",
    "Corner",
    "Counts",
    "DecodedFrame",
    "Description",
    "Device",
    "DeviceError",
    "Emission",
    "EmulatedFreeRunningArray",
    "Floats",
    "FrameDecoder",
    "FrameStream",
    "FrameTimes",
    "FreeRunningArray",
    "FreeRunningArrayConfig",
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
    "WrappedArrayConfig",
    "check_cells",
    "first_corner",
    "mounting_of",
    "printable_text",
    "source_description",
    "source_frame",
    "table_of",
    "wire_time_s",
    "wrapped_description",
]
