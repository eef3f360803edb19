"""What a run depends on beside its arguments: the clock and the ports, of a bench or of a recording."""

from collections.abc import Callable
from dataclasses import dataclass

from palpate.config import RigFile
from palpate.drivers.transport.clock import Clock
from palpate.rig.motion.hand import Hand, OpenPort

__all__ = ["Environment"]


@dataclass(frozen=True, eq=False)
class Environment:
    """A clock, what opens ports, and what the bus's adapter may add to an answer (s). Nothing else steers.

    `check` raises OutputError if the run should end because its recording has failed.
    """

    clock: Clock
    open_port: OpenPort
    latency_s: float
    check: Callable[[], None] = lambda: None

    def hand(self, rig: RigFile, notice: Callable[[str], None] = lambda _: None) -> Hand:
        """The rig's hand, connected; `notice` is told what the operator should do. Raises as `Hand` does."""
        return Hand(
            rig, self.clock, self.open_port, latency_s=self.latency_s, notice=notice, check=self.check
        )
