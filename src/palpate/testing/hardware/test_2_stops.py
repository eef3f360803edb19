"""Tests of stopping the rig, and its delay: torque without a jump, `palpate stop`, Bus Watchdog, guard."""

import json
import math
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import pytest

from palpate.base.errors import DeviceError, SafetyStop
from palpate.config import RigFile, RigOnBench
from palpate.drivers.dynamixel import ITEMS, MoveEnd, Servo, WatchdogTripped
from palpate.rig.motion.guarded_approach import move_tips, read_positions
from palpate.rig.motion.hand import WATCHDOG_S, Hand
from palpate.testing.hardware.bench import (
    AirPaths,
    HalfWay,
    HostSilence,
    Note,
    return_fingers,
    start_approaches,
)

_SETTLE_S = 0.3
_JUMP_RAD = 0.02
_STOP_COMMAND_TIMEOUT_S = 20.0  # Python's start, and two programs that share a port
_MAX_STOP_S = 0.3
_WATCHED_S = 3.0
_REST_S = 0.2
_REST_TOLERANCE_MM = 0.1  # a few steps of a servo
_SILENCE_S = 1.3
_SILENT_MM_S = 3.0
_MAX_LATE_S = 0.3  # the watchdog's step of 20 ms, a servo's lag behind its goal, and braking
_READ_PERIOD_S = 0.002


@pytest.mark.moves("nothing should: torque goes on where everything stands")
def test_torque_goes_on_without_a_jump(resting_hand: Hand, note: Note) -> None:
    """Every servo holds where it stood before torque went on."""
    servos = resting_hand.servos
    before = _angles(resting_hand, servos)
    resting_hand.prepare()
    resting_hand.pause(_SETTLE_S)
    after = _angles(resting_hand, servos)
    off = {dxl_id: abs(math.remainder(after[dxl_id] - at, 2 * math.pi)) for dxl_id, at in before.items()}
    note("largest_jump_rad", max(off.values()))
    assert max(off.values()) < _JUMP_RAD, off


@pytest.mark.moves("nothing should: torque goes on where everything stands, until `palpate stop` ends it")
def test_palpate_stop_switches_torque_off_beside_a_run(on_bench: RigOnBench, hand: Hand, note: Note) -> None:
    """Another process takes the torque away; the run notices, and all servos confirm."""
    servos, begin = hand.servos, hand.clock.now()
    noticed = False
    stop = subprocess.Popen(
        [sys.executable, "-m", "palpate", "stop", "--rig", str(on_bench.path), "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        while not noticed and hand.clock.now() - begin < _STOP_COMMAND_TIMEOUT_S:
            hand.pause(0.02)
            try:
                hand.states(servos)
            except SafetyStop:
                noticed = True
            except DeviceError:
                continue  # packets of two programs meet on the wire
        note("stopped_after_s", hand.clock.now() - begin)
        hand.close()  # stop reads every servo back as soon as the port is free
        out, err = stop.communicate(timeout=_STOP_COMMAND_TIMEOUT_S)
    finally:
        stop.kill()
        stop.wait()
    assert noticed, "torque stayed on"
    assert stop.returncode == 0, err
    told = json.loads(out)
    assert told["confirmed"]
    assert {item["id"] for item in told["servos"] if item["off"]} >= {servo.dxl_id for servo in servos}


@pytest.mark.moves("each finger creeps 10 mm in, and the host falls silent on its way; the table is clear")
def test_bus_watchdog_stops_what_moves_when_the_host_falls_silent(
    ways: AirPaths, hand: Hand, note: Note
) -> None:
    """All servos trip and stand, short of the goal; Bus Watchdog leaves torque on."""
    for _, way, _ in ways:
        (run,) = start_approaches(hand, [way])
        mover = HostSilence(hand, run, _SILENT_MM_S, _SILENCE_S)
        with pytest.raises(WatchdogTripped):
            move_tips(hand, [mover])
        servos = hand.servos
        tripped = {servo.dxl_id: servo.read("Bus Watchdog") for servo in servos}
        before = _angles(hand, servos)
        hand.clock.sleep(_SETTLE_S)
        after = _angles(hand, servos)
        hand.arm()  # clears them; they hold where they are
        read_positions(hand, [run])
        ran_mm = run.travel_mm - mover.silent_mm
        note(f"{run.finger.name}_ran_on_mm", ran_mm)
        assert tripped == dict.fromkeys(tripped, -1), "Bus Watchdog of each servo"
        assert after == pytest.approx(before, abs=0.005)
        assert ran_mm <= _SILENT_MM_S * (WATCHDOG_S + _MAX_LATE_S)
        assert run.travel_mm < mover.limit_mm - 1.0
        return_fingers(hand, [run])


@pytest.mark.moves("each finger goes 15 mm in at approach and search speed, and stops; the table is clear")
def test_a_guard_stops_a_finger(ways: AirPaths, rig: RigFile, hand: Hand, note: Note) -> None:
    """A finger turns round soon after the guard and rests; searching, it runs on less than it backs off."""
    closing = rig.closing
    for speed_mm_s in (closing.approach_speed_mm_s, closing.search_mm_s):
        for _, way, _ in ways:
            (run,) = start_approaches(hand, [way])
            mover = HalfWay(hand, run, speed_mm_s)
            assert move_tips(hand, [mover]) == {run: MoveEnd.ENOUGH}
            seen = _observe_stop(hand, mover)
            note(
                f"{run.finger.name}_at_{speed_mm_s:g}_mm_s",
                f"{1e3 * seen.forward_s:.0f} ms, {seen.ran_mm:.2f} mm",
            )
            assert seen.forward_s < _MAX_STOP_S, run.finger.name
            assert seen.rests, f"{run.finger.name} does not come to rest"
            assert run.travel_mm < mover.limit_mm - 1.0, run.finger.name
            if speed_mm_s == closing.search_mm_s:
                assert seen.ran_mm < closing.back_off_mm, f"{run.finger.name}: lower search_speed_mm_s"
            return_fingers(hand, [run])


@dataclass(frozen=True)
class StopObservation:
    """After a guard: how long (s) the tip went on, how far (mm), and whether it rests now."""

    forward_s: float
    ran_mm: float
    rests: bool


def _observe_stop(hand: Hand, mover: HalfWay) -> StopObservation:
    """Watch a tip after a guard has stopped it, until it rests."""
    run, times, travels = mover.run, [0.0], [mover.decided_mm]
    rests = False
    while not rests and times[-1] < _WATCHED_S:
        read_positions(hand, [run])
        times.append(hand.clock.now() - mover.decided_s)
        travels.append(run.travel_mm)
        last = [travel for time, travel in zip(times, travels, strict=True) if time > times[-1] - _REST_S]
        rests = times[-1] > _REST_S and max(last) - min(last) < _REST_TOLERANCE_MM
        hand.pause(_READ_PERIOD_S)
    furthest = max(travels)
    return StopObservation(times[travels.index(furthest)], furthest - mover.decided_mm, rests)


def _angles(hand: Hand, servos: Sequence[Servo]) -> dict[int, float]:
    """Present Position (rad) of servos, by id, whatever is wrong with them."""
    return {
        servo.dxl_id: (hand.bus.read(servo.dxl_id, ITEMS["Present Position"], alert=False) - servo.zero_tick)
        * servo.model.rad_per_tick
        for servo in servos
    }
