"""Expected peak force of a touch, from the speeds, the threshold and the stiffness in a rig file.

Between the contact and standing still a tip goes on by speed × latency and by what braking takes; its skin,
a spring, presses harder by stiffness × that. Latency is the wait for a frame, in the array's adapter, too,
what the array lags behind, and the look at the servos before they are told to stop:

    peak = contact_force_n + stiffness · (speed · latency + speed² / (2 · deceleration))

A stopped servo brakes with the largest torque that max_force_n lets it have and its friction, against its
rotor's inertia behind the gear. One that nobody stops, because the host or its bus is gone, presses until
its current limit and its inertia m, as a mass at the tip, are used up:

    peak = max_force_n + friction_a as a force + speed · √(stiffness · m)

Its speed is up to twice that of its profile: a servo that friction has held back falls behind its trajectory
at the profile's speed and, without losses, comes back to it as fast. None is faster than without a load.

The latency of a port's adapter is what the rig file says, or else the operating system.
"""

import math

from palpate.config import FingerConfig, RigFile
from palpate.drivers.dynamixel import RAD_PER_TICK, UNKNOWN_LATENCY_S, latency_with_timer_s, specification
from palpate.drivers.transport import EMULATED_LATENCY_S, latency_timer_s
from palpate.rig.conversion import slide_force_n
from palpate.rig.mechanisms import mechanism_of


def bus_latency_s(rig: RigFile) -> float:
    """Latency that the bus's adapter may add to an answer, by the rig file, else by the system."""
    if rig.bus.latency_ms is not None:
        return rig.bus.latency_ms / 1e3
    if rig.emulation is None:
        return port_latency_s(rig.bus.port)
    adapter = rig.emulation.bus_adapter
    return EMULATED_LATENCY_S if adapter is None else latency_with_timer_s(adapter.latency_ms / 1e3)


def _array_latency_s(rig: RigFile) -> float:
    """Time for which the arrays' adapters may hold the end of a frame back: as the system tells, else 0."""
    if rig.emulation is None:
        ports = (finger.array.port for finger in rig.fingers if finger.array.has_device)
        return max((latency_timer_s(port) or 0.0 for port in ports), default=0.0)
    adapter = rig.emulation.array_adapter
    return 0.0 if adapter is None else adapter.latency_ms / 1e3


def port_latency_s(port: str) -> float:
    """The same for a port of which no rig file tells."""
    if port.startswith("mock://"):
        return EMULATED_LATENCY_S
    timer = latency_timer_s(port)
    return UNKNOWN_LATENCY_S if timer is None else latency_with_timer_s(timer)


_WAIT_FRAMES = 1.5  # half a period until the next frame on average, and one until it is looked at
_SPEED_HALVINGS = 12  # to find a speed by its peak
_CATCH_UP_FACTOR = 2.0  # times the profile's speed, at most, while a servo catches up with its trajectory


def expected_peak_n(rig: RigFile, speed_mm_s: float) -> float:
    """Peak force (N) of the hardest of a rig's fingers on a part that does not give way, met at a speed."""
    latency_s = _WAIT_FRAMES / rig.closing.sample_rate_hz + bus_latency_s(rig) + _array_latency_s(rig)
    return rig.closing.contact_force_n + max(
        finger.tip.stiffness_n_per_mm
        * (
            speed_mm_s * (latency_s + finger.array.lag_s)
            + speed_mm_s**2 / 2 / deceleration_mm_s2(finger, rig.closing.max_force_n)
        )
        for finger in rig.fingers
    )


def quickest_mm_s(rig: RigFile, peak_n: float) -> float:
    """Speed (mm/s) from touch_speed_mm_s to the search's at which that peak is no more than `peak_n`."""
    slow, quick = rig.closing.touch_speed_mm_s, rig.closing.search_mm_s
    if expected_peak_n(rig, quick) <= peak_n:
        return quick
    for _ in range(_SPEED_HALVINGS):
        middle = (slow + quick) / 2
        slow, quick = (middle, quick) if expected_peak_n(rig, middle) <= peak_n else (slow, middle)
    return slow


def unstopped_peak_n(rig: RigFile) -> float:
    """Bound on the force (N) of any finger that runs into something firm and is told nothing any more."""
    return max(peak_n for finger in rig.fingers for peak_n, _ in unstopped_peaks_n(rig, finger))


def unstopped_peaks_n(rig: RigFile, finger: FingerConfig) -> list[tuple[float, float]]:
    """That bound by each servo that moves the tip, and the force at which its torque is that of a stall."""
    closing = rig.closing
    return [
        (
            closing.max_force_n
            + _friction_allowance_n(finger)
            + _inertial_n(finger, model, closing.approach_speed_mm_s / abs(lever_mm)),
            1e3 * specification(model).motor.stall_torque_nm / abs(lever_mm),
        )
        for model, lever_mm in mechanism_of(finger).levers
    ]


def _inertial_n(finger: FingerConfig, model: str, profile_rad_s: float) -> float:
    """Force (N) with which the tip, at its stiffest, stops a servo: speed · √(stiffness · inertia)."""
    motor = specification(model).motor
    fastest_rad_s = min(_CATCH_UP_FACTOR * profile_rad_s, motor.no_load_rad_s)
    stiffest_n_per_m = 1e3 * finger.tip.stiffness_n_per_mm * (1 + finger.tip.stiffness_spread)
    return fastest_rad_s * math.sqrt(stiffest_n_per_m * motor.inertia_kg_m2)


def _friction_allowance_n(finger: FingerConfig) -> float:
    """Force that a slide's servo may push with beside max_force_n, in case its friction does not take it."""
    slide = mechanism_of(finger).push
    return 0.0 if slide is None else slide_force_n(slide, slide.friction_a)


def deceleration_mm_s2(finger: FingerConfig, max_force_n: float) -> float:
    """Deceleration of the tip by a finger's slowest servo, of an arm when it is stretched."""
    return min(
        (max_force_n * abs(lever_mm) / 1e3 + motor.friction_nm) / motor.inertia_kg_m2 * abs(lever_mm)
        for model, lever_mm in mechanism_of(finger).levers
        for motor in (specification(model).motor,)
    )


def travel_step_mm(finger: FingerConfig) -> float:
    """Step in which a finger's servos report where its tip is along its way."""
    return max(abs(lever_mm) for _, lever_mm in mechanism_of(finger).levers) * RAD_PER_TICK
