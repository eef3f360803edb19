"""Which driver speaks a protocol: the one place that knows all drivers of tactile arrays.

Between who opens ports (`rig`) and the drivers. A new device adds its line here; `docs/adding-a-
device.md` tells the rest.
"""

from collections.abc import Callable, Mapping

from serial.serialutil import SerialBase

from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.frames import ArrayDriver
from palpate.drivers.tactile.mounting import Mounting
from palpate.drivers.tactile.stream import Port
from palpate.drivers.tactile.weiss import DsaArray, WtsArray
from palpate.drivers.transport.clock import Clock
from palpate.errors import InputError

__all__ = ["PROTOCOLS", "open_array"]

_SELF_DESCRIBING: Mapping[str, Callable[[SerialBase | Port, Clock, str], ArrayDriver]] = {
    "palpate": TactileArray,
}
_MOUNTED: Mapping[str, Callable[[SerialBase | Port, Clock, str, Mounting], ArrayDriver]] = {
    "weiss-wts": WtsArray,
    "weiss-dsa": DsaArray,
}

PROTOCOLS = (*_SELF_DESCRIBING, *_MOUNTED)
"""Names that a rig file may use."""


def open_array(
    protocol: str, port: SerialBase | Port, clock: Clock, name: str, mounting: Mounting | None
) -> ArrayDriver:
    """The driver of the array on an open port; its `connect` comes next. `name` is the finger's.

    `mounting` is needed by arrays that do not describe it themselves, and None for others. Raises
    InputError for a protocol that nothing here speaks, or without a mounting that is needed.
    """
    if protocol in _SELF_DESCRIBING:
        return _SELF_DESCRIBING[protocol](port, clock, name)
    if protocol not in _MOUNTED:
        raise InputError(
            f'tactile array {name}: no driver speaks "{protocol}"; allowed: {", ".join(PROTOCOLS)}'
        )
    if mounting is None:
        raise InputError(
            f'tactile array {name}: protocol "{protocol}" does not tell how the array is mounted; '
            "give counts_per_n"
        )
    return _MOUNTED[protocol](port, clock, name, mounting)
