"""Encoders whose magnets are off centre: emulated, within the bounds that a rig file declares, corrected."""

import math
import tomllib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.base.errors import InputError
from palpate.config import RigFile, load_objects, load_rig, shipped_objects
from palpate.config.rig_fingers import ENCODER_DEG
from palpate.drivers.arm_kinematics import ArmKinematics
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.kinematics import TICK_RAD, Encoder, Line, Servos
from palpate.rig.identification.accuracy import check_accuracy
from palpate.rig.mechanisms import kinematics_of
from support.benches.rigs import firm_rig, small
from support.benches.session import emulated_session, run_checked
from support.campaign.sampling import sample
from support.commands.repository import EXAMPLES

ARMS = EXAMPLES / "two-link-rig.toml"
SMALL_ANGLES = st.floats(-math.radians(2.0), math.radians(2.0))
HARMONICS = st.tuples(*[SMALL_ANGLES] * 4)


def with_encoders(text: str, declared_deg: float | None, drawn_deg: float = 0.0) -> dict[str, Any]:
    """A rig file's tables with another bound of encoders, or none, and with emulated errors."""
    tables = tomllib.loads(text)
    tables["emulation"]["encoder_error_deg"] = drawn_deg
    for finger in tables["fingers"]:
        del finger["bounds"]["encoder_deg"]
        if declared_deg is not None:
            finger["bounds"]["encoder_deg"] = declared_deg
    return tables


@given(harmonics=HARMONICS, read=st.floats(-300.0, 300.0))
def test_an_encoder_reads_what_its_angle_was_read_from(
    harmonics: tuple[float, float, float, float], read: float
) -> None:
    encoder = Encoder(harmonics)
    assert encoder.read_rad(encoder.angle_rad(read)) == pytest.approx(read, abs=1e-9)
    assert math.isnan(encoder.read_rad(math.nan))
    assert Encoder().angle_rad(read) == Encoder().read_rad(read) == read


@given(st.data())
def test_a_servo_whose_magnet_is_off_goes_and_reads_by_its_encoder(data: st.DataObject) -> None:
    start = data.draw(st.floats(-9.0, 9.0))
    waves = [(data.draw(st.floats(0.0, 0.03)), data.draw(st.floats(0.0, 6.0))) for _ in range(2)]
    servo = EmulatedServo(1, start_rad=start)
    servo.set_encoder(*waves)
    drive = servo._unit.drive
    off = sum(size * math.sin(k * start + phase) for k, (size, phase) in enumerate(waves, start=1))
    turn = drive.present_tick() // 4096 * 4096
    within = (drive.present_tick() - turn - 2048) * TICK_RAD
    assert math.remainder(within - start - off, math.tau) == pytest.approx(0.0, abs=TICK_RAD)
    goal = data.draw(st.floats(-9.0, 9.0))
    assert drive.read_rad(drive.angle_rad(goal)) == pytest.approx(goal, abs=1e-3 * TICK_RAD)


@pytest.mark.parametrize("path", [firm_rig(), ARMS], ids=["slide", "arm"])
@given(data=st.data())
def test_no_error_of_encoders_leaves_the_bounds(path: Any, data: st.DataObject) -> None:
    finger = load_rig(path).fingers[0]
    bound = data.draw(st.floats(0.0, 3.0))
    kinematics = kinematics_of(
        finger.replace_in_tables(bounds={"encoder_deg": bound, "base_mm": 0.0, "heading_deg": 0.0})
    )
    (near, far) = (math.radians(data.draw(st.floats(-bound, bound))) for _ in range(2))
    turns = [data.draw(st.floats(-1.0, 1.0)) for _ in range(2)]
    lo, hi = (np.array(ends) for ends in _ends(kinematics))
    read = (lo + hi) / 2 + (hi - lo) / 2 * turns
    servos: Servos = (float(read[0]), float(read[1]))
    true: Servos = (servos[0] + near, servos[1] + far)
    off = math.dist(kinematics.centre_mm(servos), kinematics.centre_mm(true))
    assert off <= kinematics.position_bound_mm(servos)
    turned = math.remainder(kinematics.facing_rad(servos) - kinematics.facing_rad(true), math.tau)
    assert abs(turned) <= kinematics.direction_bound_rad


def _ends(kinematics: Any) -> tuple[Servos, Servos]:
    """Servo angles at both ends of the ranges."""
    if isinstance(kinematics, ArmKinematics):
        (lo, hi), (near, far) = (
            (joint.servo_rad(joint.lo_rad), joint.servo_rad(joint.hi_rad))
            for joint in (kinematics.shoulder, kinematics.elbow)
        )
        return (lo, near), (hi, far)
    aims = [kinematics.aim_servo_rad(math.radians(aim)) for aim in (-35.0, 35.0)]
    return (aims[0], kinematics.slide_servo_rad(45.0)), (aims[1], kinematics.slide_servo_rad(250.0))


@given(harmonics=st.tuples(HARMONICS, HARMONICS))
def test_kinematics_go_where_encoders_that_are_known_say(
    harmonics: tuple[tuple[float, float, float, float], tuple[float, float, float, float]],
) -> None:
    for path in (firm_rig(), ARMS):
        finger = load_rig(path).fingers[0]
        x, y = finger.base_mm
        known = finger.replace_in_tables(
            **{
                key: {"encoder_harmonics_deg": tuple(math.degrees(value) for value in own)}
                for key, own in zip(finger.servos, harmonics, strict=True)
            }
        )
        kinematics = kinematics_of(known)
        plain = kinematics_of(finger)
        wanted = plain.servos_rad(Line(finger.base_mm, math.atan2(-y, -x)), 0.9 * math.hypot(x, y))
        read: Servos = tuple(
            Encoder(own).read_rad(angle) for own, angle in zip(harmonics, wanted, strict=True)
        )
        assert kinematics.centre_mm(read) == pytest.approx(plain.centre_mm(wanted), abs=1e-6)
        assert kinematics.facing_rad(read) == pytest.approx(plain.facing_rad(wanted), abs=1e-9)


@pytest.mark.parametrize("path", sample([firm_rig(), ARMS], [firm_rig()]), ids=["slides", "arms"])
def test_touches_with_encoders_off_by_all_that_is_declared_are_within_their_bounds(path: Any) -> None:
    tables = with_encoders(small(path) if path != ARMS else path.read_text(), 0.5, 0.5)
    if path == ARMS:
        tables["workspace"]["radius_mm"] = 70.0
    objects = load_objects(shipped_objects())
    objects = type(objects)((objects.objects[0],))
    touches = run_checked(emulated_session(seed=3, rig=RigFile.model_validate(tables), objects=objects), 1, 3)
    assert any(touch.contact.touched for touch in touches)


def test_a_rig_file_that_says_nothing_has_the_bound_of_the_maker() -> None:
    told = RigFile.model_validate(with_encoders(ARMS.read_text(), None))
    assert {finger.bounds.encoder_deg for finger in told.fingers} == {ENCODER_DEG}
    with pytest.raises(ValueError, match=r"is 1, beyond the bound fingers\[0\]\.bounds\.encoder_deg"):
        RigFile.model_validate(with_encoders(ARMS.read_text(), 0.5, 1.0))
    wide = RigFile.model_validate(with_encoders(ARMS.read_text(), 3.0))
    with pytest.raises(InputError, match=r"bounds\.encoder_deg.*palpate calibrate --rig arms\.toml"):
        check_accuracy(wide, "arms.toml")
