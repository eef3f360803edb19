"""What is different about emulated mechanics: drawn within what `[emulation.mechanics]` allows.

Friction, cogging and lost torque are each servo's own; a supply with a resistance is shared by all.
"""

import math
from dataclasses import replace
from functools import partial

import numpy as np

from palpate.config import EmulationConfig, RigFile
from palpate.config.emulated_mechanics import MechanicsConfig
from palpate.drivers.emulators.bench import Bench
from palpate.drivers.emulators.mechanics import ArmTruth, FingerTruth
from palpate.drivers.emulators.servo import EmulatedServo

__all__ = ["roughen", "with_cables"]

_COGS = 60  # along a turn of the output shaft
_LEAST_CHANGE_V = 0.05


def with_cables(
    truth: FingerTruth | ArmTruth, emulation: EmulationConfig, rng: np.random.Generator
) -> FingerTruth | ArmTruth:
    """The same finger, its slide pulled by a cable and giving way along its travel; arms as they are."""
    drawn = emulation.mechanics
    if drawn is None or isinstance(truth, ArmTruth):
        return truth
    cable, soft = _drawn(drawn.cable_n, 0.0, rng), _drawn(drawn.slide_deflection_mm_per_n, 0.0, rng)
    return replace(truth, cable_n=cable, slide_yield_mm_per_n=soft)


def roughen(bench: Bench, rig: RigFile, seed: int) -> None:
    """Let servos, supply and screws of a bench be as they are drawn."""
    drawn = None if rig.emulation is None else rig.emulation.mechanics
    if drawn is None:
        return
    rng = np.random.default_rng([seed, 13])
    servos = [servo for finger in bench.fingers for servo in finger.servos]
    servos += [] if bench.stage is None else [bench.stage.servo]
    for servo in servos:
        _roughen_servo(servo, drawn, rng)
    ohm = _drawn(drawn.supply_ohm, 0.0, rng)
    if ohm:
        bench.supply = _SharedSupply(servos, ohm).sag
    slipping = bench.fingers[int(rng.integers(len(bench.fingers)))]
    at, by = float(rng.uniform(*drawn.slip_after_s)), _drawn(drawn.slip_mm, 0.0, rng)
    if by:
        bench.happenings.append((at, partial(slipping.slip, by)))


def _roughen_servo(servo: EmulatedServo, drawn: MechanicsConfig, rng: np.random.Generator) -> None:
    model_nm = servo.motion.friction_nm
    servo.motion.set_mechanics(
        _drawn(drawn.friction, 1.0, rng),
        _drawn(drawn.rest_friction, 1.0, rng),
        1.0 - _drawn(drawn.torque_loss, 0.0, rng),
    )
    cogging_nm, phase = _drawn(drawn.cogging, 0.0, rng) * model_nm, float(rng.uniform(0, 2 * math.pi))
    if cogging_nm:
        servo.hold(lambda rad, _rad_s: cogging_nm * math.sin(_COGS * rad + phase))


class _SharedSupply:
    """A supply whose voltage drops by its resistance times what all motors take."""

    def __init__(self, servos: list[EmulatedServo], ohm: float) -> None:
        self._servos, self._ohm = servos, ohm
        self._full_v = self._now_v = min(servo.nominal_v for servo in servos)

    def sag(self) -> None:
        """Set the voltage that is left."""
        taken_a = sum(servo.motor_power_w for servo in self._servos) / max(self._now_v, 1.0)
        left_v = max(self._full_v - self._ohm * taken_a, 0.0)
        if abs(left_v - self._now_v) < _LEAST_CHANGE_V:
            return
        self._now_v = left_v
        for servo in self._servos:
            servo.set_supply(left_v)


def _drawn(span: tuple[float, float] | None, absent: float, rng: np.random.Generator) -> float:
    share = float(rng.uniform())
    return absent if span is None else span[0] + share * (span[1] - span[0])
