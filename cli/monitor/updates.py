"""Updates of a watch: how fast they come, what keys do, and when they end."""

from collections.abc import Sequence
from dataclasses import dataclass

from palpate.api.monitor import Monitor
from palpate.cli.monitor.display import How, Shown, shown_on
from palpate.cli.monitor.keys import Keys
from palpate.drivers.transport.clock import Clock
from palpate.rig.monitor.finger_monitor import FingerView, MonitoredFinger
from palpate.rig.monitor.paced_clock import PacedClock

__all__ = ["PaceOf", "obey", "show_updates"]


@dataclass(frozen=True)
class PaceOf:
    """How fast virtual time may pass: `speed` times the wall's; None: as fast as it is computed."""

    wall: Clock
    speed: float | None

    def on(self, clock: Clock) -> Clock:
        """The clock, held back."""
        return clock if self.speed is None else PacedClock(clock, self.wall, self.speed)


def show_updates(monitor: Monitor, how: How, keys: Keys, seconds: float | None) -> Shown:
    """Show updates until the end; returns what was shown last."""
    begin = 0.0 if monitor.session is not None else monitor.clock.now()

    def seen(views: Sequence[FingerView]) -> Shown:
        return Shown(
            rig=monitor.rig,
            session=monitor.session,
            t_s=monitor.clock.now() - begin,
            doing=monitor.stage(),
            notes=monitor.notes,
            views=tuple(views),
            keys=keys.there,
        )

    last = seen(monitor.views())
    with shown_on(how) as show:
        for views in monitor.updates(
            how.interval_s, seconds=seconds, goes_on=lambda: obey(keys.typed(), monitor.fingers)
        ):
            last = seen(views)
            show(last)
    return last


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
