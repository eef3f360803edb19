"""Tactile arrays: protocols, host drivers and contact extractor. Bytes in, contact patches out."""

from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.baseline import BOUND_SIGMAS, Baseline
from palpate.drivers.tactile.columns import column_windows, windows_within
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.contact_lines import MAX_LINE_BYTES, ContactLineDecoder, encode_line
from palpate.drivers.tactile.contact_source import SourceExtractor, source_description, source_frame
from palpate.drivers.tactile.description import Corner, Description, Mounting, Shape
from palpate.drivers.tactile.disturbances import Disturbances, find_disturbances
from palpate.drivers.tactile.exchange import ArrayExchange
from palpate.drivers.tactile.frames import (
    ArrayCounters,
    ArrayDriver,
    ArrayLost,
    ArraySilent,
    ContactReading,
    DecodedFrame,
    FrameDecoder,
    FrameTimes,
    TactileFrame,
)
from palpate.drivers.tactile.free_running import FreeRunningArray
from palpate.drivers.tactile.messages import (
    BadTaxel,
    Describe,
    Hello,
    SelfTestReport,
    SelfTestResult,
    TaxelFault,
)
from palpate.drivers.tactile.patches import ContactPatch, Patches, PatchFlag, TipCalibration
from palpate.drivers.tactile.repeats import Repeats, count_repeats, is_new
from palpate.drivers.tactile.stream import FrameStream, Port, StreamedArray

__all__ = [
    "BOUND_SIGMAS",
    "MAX_LINE_BYTES",
    "ArrayCounters",
    "ArrayDriver",
    "ArrayExchange",
    "ArrayLost",
    "ArraySilent",
    "BadTaxel",
    "Baseline",
    "ContactExtractor",
    "ContactLineDecoder",
    "ContactPatch",
    "ContactReading",
    "Corner",
    "DecodedFrame",
    "Describe",
    "Description",
    "Disturbances",
    "FrameDecoder",
    "FrameStream",
    "FrameTimes",
    "FreeRunningArray",
    "Hello",
    "Mounting",
    "PatchFlag",
    "Patches",
    "Port",
    "Repeats",
    "SelfTestReport",
    "SelfTestResult",
    "Shape",
    "SourceExtractor",
    "StreamedArray",
    "TactileArray",
    "TactileFrame",
    "TaxelFault",
    "TipCalibration",
    "column_windows",
    "count_repeats",
    "encode_line",
    "find_disturbances",
    "is_new",
    "source_description",
    "source_frame",
    "windows_within",
]
