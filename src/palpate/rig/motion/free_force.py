"""Force that a finger's currents show beyond what it has needed in free space: it has met something.

An array that feels nothing cannot tell free space from a part: it may be blind there, or on no finger at all.
Present Current holds friction, cogging and what speeds a finger up; only what exceeds them is a contact.
"""

import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from palpate.base.geometry import Floats
from palpate.drivers.dynamixel import Servo, ServoState

CURRENT_CONTACT_N = 0.8
"""Force that is a contact where friction is little: steps of Present Current and cogging are less."""

START_S = 0.4
"""Time in which a finger speeds up, needs more, and nothing is said."""

_FRICTION_SHARE = 1 / 3  # by which friction and cogging may exceed what was needed before; seen: 0.28
_FREE_S = 0.5  # before now, in which the needed force may be a contact's already
_KNOWN_WAY_MM = 20.0  # of it, after which friction and cogging are known


def torques_nm(states: Mapping[Servo, ServoState]) -> Floats:
    """Torques (Nm) of servos by their currents."""
    return np.array([state.current_a * servo.model.known_torque.nm_per_a for servo, state in states.items()])


class FreeForce:
    """Most force that a finger has needed so far on its way."""

    def __init__(self) -> None:
        self._recent: deque[tuple[float, float, float]] = deque()
        self._most_n = self._to_mm = -math.inf
        self._from_mm = math.inf

    @property
    def contact_n(self) -> float:
        """Excess (N) that neither friction nor cogging of this finger reaches."""
        return max(CURRENT_CONTACT_N, _FRICTION_SHARE * self._most_n)

    def excess_n(self, needed_n: float, travel_mm: float, now: float) -> float:
        """Force (N) beyond what was needed until half a second ago; 0 as long as that is not known."""
        while self._recent and self._recent[0][0] < now - _FREE_S:
            _, at_mm, before_n = self._recent.popleft()
            self._most_n = max(self._most_n, before_n)
            self._from_mm, self._to_mm = min(self._from_mm, at_mm), max(self._to_mm, at_mm)
        self._recent.append((now, travel_mm, needed_n))
        return needed_n - self._most_n if self._to_mm - self._from_mm >= _KNOWN_WAY_MM else 0.0
