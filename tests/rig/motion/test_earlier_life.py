"""Servos that another program has set, in whole runs: right, or refused by the cause and what mends it."""

import pytest

from palpate.base.errors import DeviceError
from palpate.base.vocabulary import IdentificationVerdict
from palpate.config import RigFile
from palpate.drivers.dynamixel.errors import NotAnswering
from palpate.recognizer import Catalogue
from palpate.rig.bench import connect, set_up
from support.benches.rigs import small_objects, small_rig
from support.benches.session import EmulatedSession, emulated_session, identify_checked, small_session


def poke(session: EmulatedSession, dxl_id: int, **items: int) -> None:
    """Items by their names, with `_` for spaces."""
    for name, value in items.items():
        session.servos[dxl_id]._unit.table.set(name.replace("_", " "), value)
        session.servos[dxl_id]._unit.drive.configure()


def refused(session: EmulatedSession) -> str:
    with pytest.raises(DeviceError) as error, connect(session.bench_rig) as hand:
        hand.prepare()
    assert not any(session.torque().values())
    return "; ".join([str(error.value), *getattr(error.value, "__notes__", [])])


def test_settings_that_a_run_owns_are_reset_and_the_answer_is_right() -> None:
    session = small_session()
    poke(session, 11, Position_P_Gain=0, Feedforward_1st_Gain=16000, Goal_PWM=10)
    poke(session, 12, Operating_Mode=5, Position_P_Gain=20, Position_D_Gain=16000, Velocity_Limit=5)
    poke(session, 21, Drive_Mode=12, Startup_Configuration=3, Status_Return_Level=0)
    poke(session, 22, Bus_Watchdog=-1, Return_Delay_Time=254)
    result = identify_checked(session, Catalogue(small_objects().objects))
    assert result.outcome is IdentificationVerdict.IDENTIFIED
    assert session.clock.now() < 40.0


@pytest.mark.parametrize("offset", [20, 40, 1000])
def test_another_homing_offset_is_refused_before_torque_goes_on(offset: int) -> None:
    session = small_session()
    poke(session, 11, Homing_Offset=offset)
    words = refused(session)
    assert "f1 aim: servo 11" in words
    assert f"Homing Offset is {offset} instead of 0" in words
    assert "palpate setup-motors --rig FILE --id 11" in words


def test_zeros_that_were_measured_with_an_offset_hold_with_it() -> None:
    data = small_rig().model_dump(mode="json", exclude_none=True)
    for finger, offset in zip(data["fingers"], (300, -40, 1000), strict=True):
        finger["aim"]["homing_offset"] = offset
    data["fingers"][1]["slide"]["homing_offset"] = 200
    session = emulated_session(rig=RigFile.model_validate(data), objects=small_objects())
    assert session.servos[22]._unit.table.get("Homing Offset") == 200
    assert identify_checked(session, Catalogue(small_objects().objects)).outcome is (
        IdentificationVerdict.IDENTIFIED
    )


@pytest.mark.parametrize(
    ("item", "value", "why"),
    [("Max_Voltage_Limit", 115, "instead of 160"), ("Temperature_Limit", 25, "instead of 80")],
)
def test_an_error_that_only_another_programs_limit_makes_is_named_so(item: str, value: int, why: str) -> None:
    session = small_session()
    poke(session, 22, **{item: value})
    words = refused(session)
    for part in ("servo 22", item.replace("_", " "), why, "palpate setup-motors", "palpate reboot"):
        assert part in words


def test_a_weak_servo_is_not_blamed_for_its_friction() -> None:
    session = small_session()
    poke(session, 11, PWM_Limit=10)
    with connect(session.bench_rig) as hand:
        hand.prepare()
        far = hand.fingers[0].kinematics.aim_servo_rad(0.5)  # type: ignore[attr-defined]
        with pytest.raises(DeviceError, match="PWM Limit is 10 instead of 885") as error:
            hand.move_servos({hand.fingers[0].drive.servos[0]: far}, lambda _: 0.01)
    assert "friction" not in str(error.value)


def test_a_servo_at_another_rate_is_found_there() -> None:
    bench = set_up(small_rig(), (), 3)
    assert bench.emulated is not None
    (servo,) = [item for item in bench.emulated.bench.servos if item.dxl_id == 31]
    servo._unit.table.set("Baud Rate", 7)
    with pytest.raises(NotAnswering, match=r"servo 31 .* at 4500000 baud, not .* 1000000") as error:
        connect(bench)
    assert not any("ModemManager" in note for note in error.value.__notes__)


def test_silence_that_was_a_restart_is_named_so() -> None:
    """Startup Configuration would let it come back with torque on, and with the marks of a backup."""
    session = small_session()
    poke(session, 12, Startup_Configuration=3)

    def run() -> None:
        with connect(session.bench_rig) as hand:
            hand.prepare()
            session.servos[12]._unit.start(0.3)
            hand.states(hand.servos)

    with pytest.raises(NotAnswering, match="has restarted") as error:
        run()
    assert not any(session.torque().values())
    assert not getattr(error.value, "__notes__", [])
    session.clock.sleep(1.0)
    assert not any(session.torque().values())
