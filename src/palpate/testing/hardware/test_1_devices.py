"""Nothing moves, torque stays off: every device answers, is as a run wants it, and is fast enough."""

import numpy as np
import pytest

from palpate.base.errors import SafetyStop
from palpate.config import RigFile
from palpate.config.diagnosis_results import ServoCheckOut
from palpate.drivers.dynamixel import (
    RETURN_DELAY_UNIT_S,
    Bus,
    OperatingMode,
    StateReader,
    StatusError,
    guarded_move,
    model_by_name,
)
from palpate.drivers.tactile import ContactExtractor
from palpate.drivers.transport import MonotonicClock, open_port
from palpate.rig.arrays import calibration_of, threshold_problem
from palpate.rig.diagnostics.array_examination import (
    check_array,
    frame_rate_hz,
    is_loss_too_high,
    is_rate_too_low,
)
from palpate.rig.diagnostics.servo_examination import check_loop, check_servo, rate_in_run_hz
from palpate.rig.fingers import ServoSettings, servo_settings
from palpate.testing.hardware.bench import ArrayUnderTest, Note, ServoUnderTest, open_bus

_BEYOND_RANGE_RAD = 0.02


def test_servo_is_of_the_named_model(servo: ServoUnderTest) -> None:
    """Its model number is that of the rig file's model."""
    assert servo.ping.model_number == model_by_name(servo.wanted.model).number


def test_servo_is_healthy(servo: ServoUnderTest, rig: RigFile, note: Note) -> None:
    """Supply, temperature, no hardware error, torque off."""
    found = _servo_check(rig, servo)
    note("supply_v", found.voltage_v)
    note("temperature_c", found.temperature_c)
    assert not found.problems


def test_servo_has_the_limits_of_a_run_in_its_eeprom(servo: ServoUnderTest, rig: RigFile) -> None:
    """What a run would write before it moves is there already: `palpate setup-motors` has been here."""
    found = _servo_check(rig, servo)
    assert found.answers, found.problems
    differing = [f"{item.item} {item.found} → {item.wanted}" for item in found.settings]
    assert not differing, "`palpate setup-motors` writes them"


def test_goals_out_of_range_are_refused(servo: ServoUnderTest, rig: RigFile) -> None:
    """By the host, with nothing sent; and by the servo itself where its mode has limits. Torque is off."""
    with open_bus(rig) as bus:
        item = _settings(rig, servo, bus)
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


@pytest.mark.usefixtures("all_servos")
def test_all_servos_are_read_at_the_sample_rate(rig: RigFile, note: Note) -> None:
    """As often as `sample_rate_hz`, over a second, but for the Return Delay Times that a run sets to 0."""
    with open_bus(rig) as bus:
        servos = [item.servo for item in servo_settings(rig, bus)]
        delays = [servo.read("Return Delay Time") * RETURN_DELAY_UNIT_S for servo in servos if servo.check()]
        loop, _ = check_loop(bus, MonotonicClock(), servos, rig.bus.baudrate_bps, delays)
        counts = bus.counts.as_dict()
    note("loop_hz", loop.rate_hz)
    note("median_ms", loop.median_ms)
    note("p99_ms", loop.p99_ms)
    note("wire_ms", loop.wire_ms)
    note("fast_sync_read", loop.fast)
    note("bus", ", ".join(f"{name} {value}" for name, value in counts.items()))
    assert rate_in_run_hz(loop, delays) >= rig.closing.sample_rate_hz, (
        "an adapter's latency timer of 1 ms and a higher baud rate help; or lower sample_rate_hz"
    )


def test_array_streams_without_loss(array: ArrayUnderTest, rig: RigFile, note: Note) -> None:
    """All arrays at once, for 5 s: frames arrive at the rate that was asked for, and hardly any gets lost."""
    found = array.recording
    rate, gone = frame_rate_hz(found.frames), found.gone
    note("frames", len(found.frames))
    note("lost", gone)
    note("rate_hz", rate)
    assert not is_loss_too_high(gone, len(found.frames)), "lost or damaged"
    assert not is_rate_too_low(rate, rig.closing.sample_rate_hz)


def test_array_is_quiet(array: ArrayUnderTest, rig: RigFile, note: Note) -> None:
    """Untouched, its noise stays below `contact_force_n`."""
    found = array.recording
    extractor = ContactExtractor(found.description, calibration_of(rig, array.spec, found.description))
    extractor.tare(found.frames)
    note("noise_counts", found.noise_counts())
    note("least_contact_force_n", extractor.least_force_n)
    assert threshold_problem(extractor, rig.closing) is None


def test_array_has_no_dead_taxels(array: ArrayUnderTest, note: Note) -> None:
    """None is dead, at full scale or unsteady but those that its calibration leaves out."""
    shown = array.untouched()
    if shown is None:
        pytest.skip("it sends too few frames to tell its dead taxels")
    taxels = array.spec.array.taxels
    known = set() if taxels is None else {(int(row), int(col)) for row, col in taxels.unusable}
    found = {(int(row), int(col)) for row, col in np.argwhere(shown.dead | shown.hot | shown.unsteady)}
    note("bad_taxels", sorted(found) or "none")
    assert found <= known, "(row, column)"
    if not shown.tells_dead:
        pytest.skip("it is too quiet at rest to tell its dead taxels: press it all over in `palpate watch`")


def test_array_examines_itself(array: ArrayUnderTest, rig: RigFile, note: Note) -> None:
    """Its self-test, if it has one, and a second of frames find nothing wrong."""
    found = check_array(rig, array.spec, MonotonicClock(), open_port)
    note("bad_taxels", "no self-test" if found.bad_taxels is None else found.bad_taxels)
    assert not found.problems


def _settings(rig: RigFile, servo: ServoUnderTest, bus: Bus) -> ServoSettings:
    return next(item for item in servo_settings(rig, bus) if item.servo.dxl_id == servo.wanted.dxl_id)


def _servo_check(rig: RigFile, servo: ServoUnderTest) -> ServoCheckOut:
    with open_bus(rig) as bus:
        return check_servo(bus, _settings(rig, servo, bus))
