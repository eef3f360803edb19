"""Steps of a diagnosis: the case under examination, names of devices, and the creation of findings."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Flag

from palpate.base.errors import complete_commands
from palpate.config import FingerConfig, RigFile, RigOnBench
from palpate.config.diagnosis_results import Cause, FindingOut, Severity
from palpate.rig.diagnostics.host_ports import Computer
from palpate.rig.diagnostics.servo_bus import BusEndpoint

NOTHING_TO_DO = "nothing"
"""How the next thing to do begins where there is none."""

CHECK_LISTEN_S = 1.0
_FULL_LISTEN_S = 3.0
"""How long arrays stream, untouched, for a check and for a full one."""

_MAX_LISTED = 6

Judgement = tuple[str, Sequence[FindingOut]]
"""What a step saw, in words, and what is not as it should be."""


@dataclass(frozen=True, eq=False)
class DiagnosisCase:
    """Case that is examined: a rig, where its ports are, the computer; `tell` hears what is looked at now."""

    on_bench: RigOnBench
    place: BusEndpoint
    computer: Computer
    tell: Callable[[str], None] = lambda _: None
    listen_s: float = _FULL_LISTEN_S

    @property
    def rig(self) -> RigFile:
        """The rig with its calibration laid over it."""
        return self.on_bench.rig

    def with_commands(self, found: FindingOut) -> FindingOut:
        """A finding whose next thing to do names this rig's file in each command."""
        do = complete_commands(found.next, str(self.on_bench.path))
        return found.model_copy(update={"next": do})

    def calibrate_or(self, by_hand: str) -> str:
        """The command that calibrates this rig; what to do `by_hand` if it has pads."""
        return by_hand if self.rig.why_not("calibrate") else "palpate calibrate"


@dataclass(frozen=True, eq=False)
class MotionStep:
    """A step for which fingers move, once nothing else is wrong: what it does, or why it was not asked for.

    What it does ends in a judgement, or in the reason why it was not done. `despite`: causes of findings that
    do not keep it from being done, and that it may explain.
    """

    name: str
    looked_at: str
    carry_out: Callable[[], Judgement | str] | str
    despite: frozenset[Cause] = frozenset()


@dataclass(frozen=True, slots=True)
class NamedDevice:
    """A device or several in words, with the ids of servos and names of arrays among them."""

    name: str
    servos: tuple[int, ...] = ()
    arrays: tuple[str, ...] = ()


BUS = NamedDevice("the servos' bus")


def name_servo(owner: str, dxl_id: int) -> NamedDevice:
    """A servo as findings call it."""
    return NamedDevice(f"servo {dxl_id} ({owner})", (dxl_id,))


def name_array(spec: FingerConfig) -> NamedDevice:
    """A finger's array as findings call it."""
    return NamedDevice(f"array {spec.name}", arrays=(spec.name,))


def name_port(rig: RigFile, port: str) -> NamedDevice:
    """A port of the rig file, with what hangs on it."""
    arrays = tuple(finger.name for finger in rig.fingers if finger.array.port == port)
    user = f"array {arrays[-1]}" if arrays else BUS.name
    return NamedDevice(f"port {port} ({user})", arrays=arrays)


def name_together(name: str, devices: Iterable[NamedDevice]) -> NamedDevice:
    """Several devices by a name of their own."""
    found = tuple(devices)
    servos = tuple(dxl_id for item in found for dxl_id in item.servos)
    return NamedDevice(name, servos, tuple(array for item in found for array in item.arrays))


def wrong(cause: Cause, device: NamedDevice, saw: str, means: str, do: str) -> FindingOut:
    """A finding with which the rig cannot be worked."""
    return _finding(cause, Severity.WRONG, device, (saw, means, do))


def warning(cause: Cause, device: NamedDevice, saw: str, means: str, do: str) -> FindingOut:
    """A finding with which it can."""
    return _finding(cause, Severity.WARNING, device, (saw, means, do))


def _finding(cause: Cause, severity: Severity, device: NamedDevice, said: tuple[str, str, str]) -> FindingOut:
    saw, means, do = said
    return FindingOut(
        cause=cause,
        severity=severity,
        device=device.name,
        servos=device.servos,
        arrays=device.arrays,
        saw=saw,
        means=means,
        next=do,
    )


def port_failed(case: DiagnosisCase, failure: str) -> Judgement:
    """The bus's port, which was there, has failed."""
    means = "the adapter broke off while it was used"
    do = "plug the adapter in directly, without a hub, and run this again"
    found = wrong(Cause.PORT_UNUSABLE, NamedDevice(f"port {case.rig.bus.port}"), failure, means, do)
    return "the port failed", [found]


def name_flag(flag: Flag) -> str:
    """A device's flag in words."""
    return str(flag.name).replace("_", " ").lower()


def join_words(items: Sequence[str], most: int = _MAX_LISTED, what: str = "") -> str:
    """List of items in words: "a, b and c"; of more than `most` the first, and how many more, of `what`."""
    if len(items) > most:
        return f"{', '.join(items[:most])} and {len(items) - most} more {what}".rstrip()
    return " and ".join(filter(None, (", ".join(items[:-1]), items[-1]))) if items else "none"
