"""Identity of devices: whether those that are connected are those that were calibrated.

An array or a servo that was replaced has other gains, another play, another zero.
"""

from collections.abc import Mapping

from palpate.base.errors import InputError
from palpate.config import CalibrationDevice, CalibrationFile
from palpate.drivers.dynamixel.servo import Servo
from palpate.rig.motion.hand import Hand

__all__ = ["check_arrays", "check_devices", "devices_of", "other_device"]


def devices_of(hand: Hand) -> list[CalibrationDevice]:
    """Every device of a connected hand: servos, the stage's first, then arrays, in the fingers' order."""
    port = hand.rig.bus.port
    servos = [
        CalibrationDevice(
            port=port,
            kind="servo",
            id=str(servo.dxl_id),
            model=servo.model.name,
            firmware=str(servo.check().firmware),
        )
        for servo in _servos(hand)
    ]
    arrays = []
    for finger in hand.fingers:
        described = finger.array.description
        size = f"{described.rows} x {described.cols}"
        arrays.append(
            CalibrationDevice(
                port=finger.spec.array.port,
                kind="array",
                id=described.unique_id.hex(),
                model=f"{finger.spec.array.protocol}, {size} {described.shape.name.lower()}",
                firmware=described.firmware or "unknown",
            )
        )
    return [*servos, *arrays]


def check_devices(file: CalibrationFile | None, hand: Hand) -> None:
    """Raise InputError if a connected device is not the one that was calibrated. Nothing is sent."""
    if file is None:
        return
    servos = {servo.dxl_id: servo.model.name for servo in _servos(hand)}
    _refuse(file, _other_servo(file, servos))
    check_arrays(file, {finger.name: finger.array.description.unique_id.hex() for finger in hand.fingers})


def check_arrays(file: CalibrationFile | None, arrays: Mapping[str, str]) -> None:
    """Raise InputError if one of some fingers' arrays, by unique id, is not the one that was calibrated."""
    if file is not None:
        _refuse(file, _other_array(file, arrays))


def other_device(file: CalibrationFile, servos: Mapping[int, str], arrays: Mapping[str, str]) -> str | None:
    """In words, the first device that is not the one that was calibrated; None if all that are given are.

    `servos`: model by id. `arrays`: unique id in hexadecimal by finger; fingers may be left out.
    """
    return _other_servo(file, servos) or _other_array(file, arrays)


def _other_servo(file: CalibrationFile, servos: Mapping[int, str]) -> str | None:
    for device in file.devices:
        model = servos.get(int(device.id)) if device.kind == "servo" and device.id.isdecimal() else None
        if model is not None and model != device.model:
            return f"was made with servo {device.id} a {device.model}, which is a {model} now"
    return None


def _other_array(file: CalibrationFile, arrays: Mapping[str, str]) -> str | None:
    calibrated = [device.id for device in file.devices if device.kind == "array"]
    if len(calibrated) != len(file.fingers):
        return f"names {len(calibrated)} arrays for {len(file.fingers)} fingers"
    for finger, wanted in zip(file.fingers, calibrated, strict=True):
        found = arrays.get(finger.name, wanted)
        if found != wanted:
            return f"was made with array {wanted} on finger {finger.name}, which has array {found} now"
    return None


def _refuse(file: CalibrationFile, other: str | None) -> None:
    # A replay says the same from another folder, so no path is named.
    if other is not None:
        raise InputError(
            f'the calibration of rig "{file.rig}" {other}: calibrate again with `palpate calibrate`, or '
            "leave it out with --no-calibration (an emulated rig's devices are those of its --seed)"
        )


def _servos(hand: Hand) -> list[Servo]:
    stage = [] if hand.stage is None else [hand.stage.servo]
    return [*stage, *(servo for finger in hand.fingers for servo in finger.drive.servos)]
