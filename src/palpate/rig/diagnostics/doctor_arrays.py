"""Doctor, arrays: asks each array who it is, and listens to it untouched; what is judged is in `array_steps`.

An array that is silent is looked for at other baud rates and with other protocols.
"""

from contextlib import suppress
from dataclasses import dataclass
from typing import cast

from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError, PalpateError
from palpate.config import FingerConfig
from palpate.config.rig_fingers import PALPATE_PROTOCOL, SHIPPED_PROTOCOLS, ArrayConfig
from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.exchange import ArrayExchange
from palpate.drivers.tactile.frames import ArrayDriver, TactileFrame
from palpate.drivers.tactile.messages import Describe, Description, Hello, SelfTestReport
from palpate.drivers.tactile.stream import Port
from palpate.drivers.transport.port import has_baudrate
from palpate.rig.arrays import array_of, array_plugin
from palpate.rig.diagnostics.array_check import listen
from palpate.rig.diagnostics.doctor_steps import Case
from palpate.rig.diagnostics.frame_stream import frames_gone

__all__ = ["LISTEN_S", "ArraySeen", "look_at_arrays"]

LISTEN_S = 3.0
"""How long an array is listened to, untouched."""

_OTHER_RATES = (115_200, 230_400, 460_800, 500_000, 921_600, 1_000_000, 2_000_000, 3_000_000)
_ANSWER_S = 0.3
_TRIES = 2


@dataclass(frozen=True, eq=False)
class ArraySeen:
    """An array: what it says of itself, and its frames of `LISTEN_S`.

    `description` is None if it did not introduce itself: `failure` says why, `other_rate` or `other_protocol`
    how it does answer, `noisy` that bytes come which are no message, `answered` that it does answer, with
    something that cannot be used. `broken` says what failed after that.
    """

    spec: FingerConfig
    description: Description | None = None
    failure: str | None = None
    other_rate: int | None = None
    other_protocol: str | None = None
    noisy: bool = False
    answered: bool = False
    report: SelfTestReport | None = None
    frames: tuple[TactileFrame, ...] = ()
    lost: int = 0
    broken: str | None = None

    @property
    def name(self) -> str:
        """How findings call it."""
        return f"array {self.spec.name}"


def look_at_arrays(case: Case, usable: frozenset[str]) -> list[ArraySeen]:
    """Look at the arrays whose ports are usable, one after the other."""
    return [_look(case, spec) for spec in case.rig.fingers if spec.array.port in usable]


def _look(case: Case, spec: FingerConfig) -> ArraySeen:
    case.tell(f"array of finger {spec.name}")
    clock = case.place.clock
    try:
        port = case.place.open_other(spec.array.port, spec.array.baudrate_bps)
    except DeviceError as error:
        return ArraySeen(spec, failure=str(error))
    try:
        array = array_of(spec, port, clock)
        try:
            description = array.connect()
        except DeviceError as error:
            return _unknown(case, spec, port, str(error))
        return _heard(case, spec, array, description)
    finally:
        with suppress(Exception):
            port.close()


def _heard(case: Case, spec: FingerConfig, array: ArrayDriver, description: Description) -> ArraySeen:
    """An array that has introduced itself, listened to."""
    report, frames, broken, before = None, [], None, array.counters
    try:
        report = array.self_test_if_known() if isinstance(array, TactileArray) else None
        case.tell(f"listening to array of finger {spec.name}")
        before = array.counters
        frames = _listen(case, array)
    except DeviceError as error:
        broken = str(error)
    return ArraySeen(
        spec,
        description,
        report=report,
        frames=tuple(frames),
        lost=frames_gone(before, array.counters),
        broken=broken,
    )


def _listen(case: Case, array: ArrayDriver) -> list[TactileFrame]:
    try:
        array.start(case.rig.closing.sample_rate_hz)
        return listen(array, case.place.clock, LISTEN_S)
    finally:
        with suppress(DeviceError):  # what ended the stream says more
            array.stop()


def _unknown(case: Case, spec: FingerConfig, port: SerialBase, failure: str) -> ArraySeen:
    """An array that does not introduce itself: how else it may answer."""
    own = spec.array.baudrate_bps
    noisy = "is no message" in failure
    try:
        answers, heard = _hello(case, spec, port)
        noisy = noisy or heard
    except DeviceError:  # it answers something
        return ArraySeen(spec, failure=failure, answered=spec.array.protocol == PALPATE_PROTOCOL)
    if answers and spec.array.protocol == PALPATE_PROTOCOL:
        return ArraySeen(spec, failure=failure, answered=True)
    if answers:
        return ArraySeen(spec, failure=failure, other_protocol=PALPATE_PROTOCOL)
    for rate in _OTHER_RATES if has_baudrate(spec.array.port) else ():
        if rate != own and spec.array.protocol == PALPATE_PROTOCOL:
            case.tell(f"array of finger {spec.name} at {rate} baud")
            port.baudrate = rate
            with suppress(DeviceError):
                if _hello(case, spec, port)[0]:
                    return ArraySeen(spec, failure=failure, other_rate=rate)
    port.baudrate = own
    return ArraySeen(spec, failure=failure, noisy=noisy, other_protocol=_other_protocol(case, spec, port))


def _hello(case: Case, spec: FingerConfig, port: SerialBase) -> tuple[bool, bool]:
    """Whether palpate's own protocol is answered, and whether anything is heard. Raises DeviceError."""
    _drop_unread(port)
    exchange = ArrayExchange(port, case.place.clock, spec.name, lambda *_: None)
    answer = exchange.ask(Hello, Describe, _ANSWER_S, _TRIES)
    return isinstance(answer, Describe), bool(exchange.noise)


def _drop_unread(port: SerialBase) -> None:
    readable = cast("Port", port)
    readable.read(readable.in_waiting)


def _other_protocol(case: Case, spec: FingerConfig, port: SerialBase) -> str | None:
    """The first of the shipped protocols, but for the rig file's, in which the array introduces itself."""
    for name in SHIPPED_PROTOCOLS:
        if name == spec.array.protocol:
            continue
        case.tell(f"array of finger {spec.name} as {name}")
        table = {
            "port": spec.array.port,
            "baudrate_bps": spec.array.baudrate_bps,
            "protocol": name,
            "gain_spread": 0.0,
            "counts_per_n": 1.0,
        }
        with suppress(PalpateError, ValueError):
            config = ArrayConfig.model_validate(table)
            plugin = array_plugin(name)
            _drop_unread(port)
            plugin.driver(
                cast("Port", port), case.place.clock, spec.name, config, spec.tip.radius_mm
            ).connect()
            return name
    return None
