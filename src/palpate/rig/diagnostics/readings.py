"""Readings of a rig for its diagnosis: ports, devices that answer on the bus, servos, arrays.

They are taken once, and each step judges a part of them. What a step needs is a function of the readings,
which says why the step must be skipped.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from palpate.base.errors import DeviceError
from palpate.config import RigServo
from palpate.config.diagnosis_results import FindingOut, TouchForceOut
from palpate.drivers.dynamixel import FoundServo, model_name
from palpate.drivers.transport import PortForbidden, PortTaken
from palpate.rig.diagnostics.array_examination import ExaminedArray, UntouchedArray
from palpate.rig.diagnostics.servo_examination import ExaminedServo, ExaminedServos
from palpate.rig.diagnostics.steps import DiagnosisCase


@dataclass(frozen=True, eq=False)
class AnsweringServos:
    """Servos of the rig file, and what answers: at its baud rate, and elsewhere."""

    owned: tuple[RigServo, ...]
    here: tuple[FoundServo, ...]
    elsewhere: tuple[FoundServo, ...]

    @property
    def missing(self) -> list[RigServo]:
        """Servos that do not answer at the rig file's rate."""
        there = {item.dxl_id for item in self.here}
        return [servo for servo in self.owned if servo.dxl_id not in there]

    @property
    def at_other_rate(self) -> list[tuple[RigServo, FoundServo]]:
        """Servos that are missing, and answer to their id at another rate."""
        by_id = {item.dxl_id: item for item in self.elsewhere}
        return [(servo, by_id[servo.dxl_id]) for servo in self.missing if servo.dxl_id in by_id]

    @property
    def strangers(self) -> list[FoundServo]:
        """Servos that answer to an id that the rig file does not have."""
        ids = {servo.dxl_id for servo in self.owned}
        return [item for item in (*self.here, *self.elsewhere) if item.dxl_id not in ids]

    @property
    def clear(self) -> dict[int, FoundServo]:
        """Servos that answer at the rig file's rate, each alone to its id."""
        return {item.dxl_id: item for item in self.here if item.ping is not None and not item.crowded}

    @property
    def sound(self) -> frozenset[int]:
        """Ids of the rig's servos that answer as the rig file says."""
        models = {dxl_id: model_name(item.ping) for dxl_id, item in self.clear.items()}
        return frozenset(item.dxl_id for item in self.owned if models.get(item.dxl_id) == item.model)


@dataclass(frozen=True, eq=False)
class Readings:
    """All that was read. `ports`: why each port of the rig file does not open, None if it does.

    `bus` is None if its port does not open or failed, `servos` if none was examined. `bus_error`: why the
    bus could not be read. `misfits`: of arrays that introduced themselves; `untouched` are those that fit.
    """

    now: datetime
    ports: Mapping[str, DeviceError | None]
    timers_s: Mapping[str, float | None]
    bus: AnsweringServos | None
    servos: ExaminedServos | None
    bus_error: DeviceError | None
    arrays: Sequence[ExaminedArray]
    misfits: Mapping[ExaminedArray, Sequence[FindingOut]]
    untouched: Sequence[UntouchedArray]
    touch_force: TouchForceOut

    @property
    def with_taxels(self) -> Sequence[UntouchedArray]:
        """Untouched arrays that are no contact sources."""
        return [array for array in self.untouched if not array.seen.spec.array.reports_contacts]

    @property
    def usable(self) -> frozenset[str]:
        """Ports that open."""
        return frozenset(port for port, error in self.ports.items() if error is None)

    @property
    def ports_there(self) -> Sequence[str]:
        """Ports that are there, be it that they may not be opened or are taken."""
        return [port for port in self.ports if port in self.usable] + self.ports_with(
            PortForbidden, PortTaken
        )

    def ports_with(self, *kinds: type[DeviceError]) -> list[str]:
        """Ports that do not open for one of some reasons."""
        return [port for port, error in self.ports.items() if isinstance(error, kinds)]

    @property
    def examined(self) -> Sequence[ExaminedServo]:
        """Servos that were examined."""
        return () if self.servos is None else self.servos.servos


Need = Callable[[DiagnosisCase, Readings], str | None]
"""A condition of a step: why it must be skipped, None if it need not."""


def need_port(*kinds: type[DeviceError]) -> Need:
    """The need of a port that opens, or does not for one of some reasons."""

    def why(_case: DiagnosisCase, readings: Readings) -> str | None:
        there = readings.usable or readings.ports_with(*kinds)
        return None if there else "no port of the rig file could be opened"

    return why


def need_bus_port(case: DiagnosisCase, readings: Readings) -> str | None:
    """The need of the bus's port."""
    port = case.rig.bus.port
    return None if port in readings.usable else f"the bus's port {port} cannot be used"


def need_answers(_case: DiagnosisCase, readings: Readings) -> str | None:
    """The need of a servo that answers, whichever and at whatever rate."""
    if readings.bus is None:
        return "the port failed"
    return None if readings.bus.here or readings.bus.elsewhere else "no servo answers"


def need_clear_servo(_case: DiagnosisCase, readings: Readings) -> str | None:
    """The need of a servo of the rig file that answers alone to its id."""
    bus = readings.bus
    there = bus is not None and any(servo.dxl_id in bus.clear for servo in bus.owned)
    return None if there else "no servo of the rig file answers as it should"


def need_sound_servo(_case: DiagnosisCase, readings: Readings) -> str | None:
    """The need of a servo that answers as the rig file says."""
    sound = readings.bus is not None and readings.bus.sound
    return None if sound else "no servo answers as the rig file says"


def need_servos(_case: DiagnosisCase, readings: Readings) -> str | None:
    """The need of servos that were examined to the end."""
    return None if readings.servos is not None else "the bus's port failed"


def need_read_servo(_case: DiagnosisCase, readings: Readings) -> str | None:
    """The need of a servo that could be read."""
    there = any(item.health is not None for item in readings.examined)
    return None if there else "no servo could be read"


def need_settings(_case: DiagnosisCase, readings: Readings) -> str | None:
    """The need of a servo that could be read, or whose model cannot keep the rig file's limits."""
    there = any(item.health is not None or item.unable for item in readings.examined)
    return None if there else "no servo could be read"


def need_array(case: DiagnosisCase, readings: Readings) -> str | None:
    """The need of an array whose port can be used."""
    if not any(finger.array.has_device for finger in case.rig.fingers):
        return "this rig has no arrays: its fingers sense by Present Current"
    return None if readings.arrays else "no array's port can be used"


def need_described_array(_case: DiagnosisCase, readings: Readings) -> str | None:
    """The need of an array that introduces itself."""
    return None if readings.misfits else "no array answers as it should"


def need_fitting_array(_case: DiagnosisCase, readings: Readings) -> str | None:
    """The need of an array that fits the rig file."""
    return None if readings.untouched else "no array is of the rig file's geometry"


def need_taxels(_case: DiagnosisCase, readings: Readings) -> str | None:
    """The need of an array that has taxels, and fits."""
    return None if readings.with_taxels else "contact sources have no taxels"


def need_frames(_case: DiagnosisCase, readings: Readings) -> str | None:
    """The need of an array that sends frames enough to judge its taxels."""
    heard = any(array.shown is not None for array in readings.untouched)
    return None if heard else "no array sends enough frames"
