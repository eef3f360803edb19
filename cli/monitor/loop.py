"""The loop of `palpate watch`: poll often, show seldom, obey keys. Between fingers and screen."""

from collections.abc import Callable, Sequence

from palpate.drivers.transport.clock import Clock
from palpate.errors import DeviceError
from palpate.rig.monitor.finger_monitor import FingerView, MonitoredFinger

__all__ = ["GONE_S", "POLL_S", "end_if_silent", "obey", "watch"]

POLL_S = 0.01
"""Ports are emptied this often: a terminal's buffer holds 4 kB, a dozen frames of 8 x 20."""

GONE_S = 3.0
"""An array that was started and sends nothing for so long is gone."""


def watch(
    fingers: Sequence[MonitoredFinger],
    clock: Clock,
    show: Callable[[Sequence[FingerView]], None],
    *,
    interval_s: float,
    goes_on: Callable[[], bool],
    seconds: float | None = None,
) -> None:
    """Show the fingers every `interval_s` on `clock`, and at the end.

    Ends after `seconds`, or once `goes_on`, which is asked at every poll, says so. Raises what `poll` of
    a finger and `goes_on` raise.
    """
    begin = clock.now()
    due = begin + interval_s
    while goes_on():
        clock.sleep(POLL_S)
        for finger in fingers:
            finger.poll()
        now = clock.now()
        if seconds is not None and now - begin >= seconds:
            break
        if now >= due:
            show([finger.view() for finger in fingers])
            due += interval_s
            if due <= clock.now():  # showing took longer than that: polls come first
                due = clock.now() + interval_s
    show([finger.view() for finger in fingers])


def obey(typed: str, fingers: Sequence[MonitoredFinger]) -> bool:
    """Do what was typed: t tares, r resets the counters; returns False for q."""
    for key in typed.lower():
        if key == "q":
            return False
        for finger in fingers:
            if key == "t":
                finger.tare()
            elif key == "r":
                finger.reset_counters()
    return True


def end_if_silent(fingers: Sequence[MonitoredFinger], rate_hz: float) -> None:
    """Raise DeviceError, which names the finger, if an array that streams at `rate_hz` has stopped."""
    for finger in fingers:
        limit = max(GONE_S, 5 / rate_hz)
        if finger.age_s > limit:
            instead = finger.array.silence
            but = "" if instead == "nothing" else f", but {instead}"
            raise DeviceError(
                f"tactile array {finger.name} on {finger.port} sent no frame for {limit:g} s{but}; "
                "check its power and its cable, then watch again"
            )
