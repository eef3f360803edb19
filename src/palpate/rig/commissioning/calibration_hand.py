"""Connector of a rig for the steps of a calibration, each with a hand of its own."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from palpate.config import RigFile
from palpate.rig.commissioning.calibration import ConnectedRig, RigConnector
from palpate.rig.commissioning.rig_prober import HandProber, Table
from palpate.rig.motion.calibrated_devices import devices_of
from palpate.rig.session.environment import Environment

__all__ = ["rig_connector"]


def rig_connector(environment: Environment, table: Table, notice: Callable[[str], None]) -> RigConnector:
    """A connector of the rig in this environment; `notice` is called with what the operator should do."""

    @contextmanager
    def connect(rig: RigFile, *, moving: bool) -> Iterator[ConnectedRig]:
        with environment.hand(rig, notice) as hand:
            if moving:
                hand.prepare()
            arrays = [finger.array.description for finger in hand.fingers]
            yield ConnectedRig(HandProber(hand, table), arrays, devices_of(hand), hand.emulated)

    return connect
