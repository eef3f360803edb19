"""Tests with torque off and no motion: every device answers, has the settings of a run, and is fast enough.

The steps are those of `palpate check --full`, with more frames. Settings that a first run would correct, and
causes of slow runs, fail here, too.
"""

from collections.abc import Callable, Mapping

import numpy as np
import pytest

from palpate.base.errors import SafetyStop
from palpate.config import FingerConfig, RigFile, RigServo
from palpate.config.diagnosis_results import Cause, FindingOut, Outcome, Severity
from palpate.drivers.dynamixel import OperatingMode, StateReader, StatusError, guarded_move
from palpate.drivers.transport import MonotonicClock
from palpate.rig.arrays import bare_extractor
from palpate.rig.diagnostics.array_examination import UntouchedArray, frame_rate_hz
from palpate.rig.diagnostics.diagnosis import Diagnosis, Step
from palpate.rig.diagnostics.readings import Readings
from palpate.rig.fingers import servo_settings
from palpate.testing.hardware.bench import Note, open_bus

_STRICT = {Cause.LIMITS_NOT_SET, Cause.FRAMES_SLOW, Cause.BUS_SLOW}
_BEYOND_RANGE_RAD = 0.02


def test_step(step: Step, device: RigServo | FingerConfig | None, diagnosis: Diagnosis, note: Note) -> None:
    """A step finds nothing wrong with a device, or with the rig as a whole."""
    result = next(item for item in diagnosis.steps if item.step == step.name)
    if result.outcome is Outcome.SKIPPED:
        pytest.skip(str(result.skipped_because))
    found = [item for item in result.findings if _is_about(item, step, device)]
    if not found and _is_unseen(step, device, diagnosis.readings):
        pytest.skip("it was not looked at: see the steps before")
    if device is None:
        note("saw", result.saw)
    for name, value in _figures(step, device, diagnosis).items():
        note(name, value)
    wrong = []
    for item in found:
        text = f"{item.device}: {item.saw}; {item.next}"
        if item.severity is Severity.WRONG or item.cause in _STRICT:
            wrong.append(text)
        else:
            note("warning", text)
    if wrong:
        pytest.fail("\n".join(wrong), pytrace=False)


def _is_about(finding: FindingOut, step: Step, device: RigServo | FingerConfig | None) -> bool:
    if device is None:
        return step.about is None or not (finding.servos or finding.arrays)
    return device.dxl_id in finding.servos if isinstance(device, RigServo) else device.name in finding.arrays


def _is_unseen(step: Step, device: RigServo | FingerConfig | None, readings: Readings) -> bool:
    """Return whether what is wrong with a device in an earlier step hides it from this one."""
    if device is None or step.name in ("baud rate", "ids", "arrays answer"):
        return False
    if isinstance(device, RigServo):
        bus = readings.bus
        seen = {item.dxl_id for item in readings.examined}
        return device.dxl_id not in (bus.clear if bus is not None and step.name == "models" else seen)
    return not any(item.seen.spec.name == device.name for item in readings.untouched)


def _figures(
    step: Step, device: RigServo | FingerConfig | None, diagnosis: Diagnosis
) -> Mapping[str, object]:
    """Figures of a device, or of the bus, that belong to a step."""
    readings = diagnosis.readings
    if device is None:
        return _of_bus(readings) if step.name == "bus traffic" else {}
    if isinstance(device, RigServo):
        return _of_servo(step.name, device, readings)
    figures = _ARRAY_FIGURES.get(step.name)
    seen = (item for item in readings.untouched if item.seen.spec.name == device.name)
    return {name: value for item in seen if figures for name, value in figures(diagnosis, item).items()}


def _of_bus(readings: Readings) -> Mapping[str, object]:
    servos = readings.servos
    if servos is None:
        return {}
    counts = ", ".join(f"{name} {value}" for name, value in servos.counts)
    if servos.loop is None:
        return {"bus": counts}
    loop = {f"loop_{name}": value for name, value in servos.loop}
    return loop | {"bus": counts}


def _of_servo(step: str, device: RigServo, readings: Readings) -> Mapping[str, object]:
    for item in readings.examined:
        if item.dxl_id == device.dxl_id and step == "firmware":
            name = f"{device.dxl_id} ({device.owner})"
            return {"servo": name, "model": device.model, "firmware": item.firmware}
        if item.dxl_id == device.dxl_id and item.health is not None and step == "hardware errors":
            return {"supply_v": item.health.voltage_v, "temperature_c": item.health.temperature_c}
    return {}


def _identity(_diagnosis: Diagnosis, array: UntouchedArray) -> Mapping[str, object]:
    described, spec = array.seen.description, array.seen.spec
    assert described is not None
    return {
        "array": f"{spec.name} on {spec.array.port}",
        "protocol": spec.array.protocol,
        "array_firmware": described.firmware,
        "unique_id": described.unique_id.hex(),
        "geometry": f"{described.rows} x {described.cols} {described.shape.name.lower()}",
        "emulated": described.emulated,
    }


def _stream(_diagnosis: Diagnosis, array: UntouchedArray) -> Mapping[str, object]:
    frames = array.seen.frames
    return {"frames": len(frames), "lost": array.seen.lost, "rate_hz": frame_rate_hz(frames)}


def _taxels(_diagnosis: Diagnosis, array: UntouchedArray) -> Mapping[str, object]:
    shown = array.shown
    if shown is None:
        return {}
    bad = [(int(row), int(col)) for row, col in np.argwhere(shown.dead | shown.hot | shown.unsteady)]
    untold = "too quiet at rest to tell: press it all over in `palpate watch`"
    return {"bad_taxels": bad or "none"} | ({} if shown.tells_dead else {"dead_taxels": untold})


def _noise(diagnosis: Diagnosis, array: UntouchedArray) -> Mapping[str, object]:
    described, spec = array.seen.description, array.seen.spec
    if array.shown is None or described is None:
        return {}
    extractor = bare_extractor(diagnosis.case.rig, spec, described)
    extractor.tare(array.seen.frames)
    return {"noise_counts": array.shown.noise_counts, "least_contact_force_n": extractor.least_force_n}


_ARRAY_FIGURES: Mapping[str, Callable[[Diagnosis, UntouchedArray], Mapping[str, object]]] = {
    "arrays answer": _identity,
    "frames": _stream,
    "taxel map": _taxels,
    "noise and drift": _noise,
}


def test_goals_out_of_range_are_refused(servo: RigServo, rig: RigFile) -> None:
    """The host refuses and sends nothing; the servo itself does where its mode has limits. Torque is off."""
    with open_bus(rig) as bus:
        item = next(item for item in servo_settings(rig, bus) if item.servo.dxl_id == servo.dxl_id)
        item.servo.check()
        assert item.servo.read("Torque Enable") == 0
        reader = StateReader(bus, [item.servo])
        reader.arrange()
        for beyond in (
            item.servo.range_rad[0] - _BEYOND_RANGE_RAD,
            item.servo.range_rad[1] + _BEYOND_RANGE_RAD,
        ):
            sent = bus.counts.instructions
            with pytest.raises(SafetyStop, match="nothing was sent"):
                guarded_move(reader, MonotonicClock(), {item.servo: beyond})
            assert bus.counts.instructions == sent
        if item.limits.mode is not OperatingMode.POSITION:
            return
        highest = item.servo.read("Max Position Limit")
        before = item.servo.read("Goal Position")
        with pytest.raises(StatusError):
            bus.write(item.servo.dxl_id, item.servo.item("Goal Position"), highest + 1)
        assert item.servo.read("Goal Position") == before
