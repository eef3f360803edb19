"""Updates of a watch: what keys do, and when they end."""

from collections.abc import Sequence

from palpate.cli.monitor.display import How, Shown, shown_on
from palpate.cli.monitor.keys import Keys
from palpate.jobs.monitor import Monitor
from palpate.rig.monitor.finger_monitor import FingerView, MonitoredFinger

__all__ = ["obey", "show_updates"]


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
