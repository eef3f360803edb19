"""Emulated joints between a servo and a tip: play, and how they give way to a force on the tip.

A gear and what it turns wind up elastically, quasi-statically and with a short lag. Friction holds the driven
side somewhere within its play; a force on the tip that overcomes it pushes the driven side to its flank. Both
are solved implicitly against the tip's stiffness, so that a step of any length is stable.
"""

from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["Joint", "JointYield", "Play"]

_LAG_S = 0.005  # until 63 % of what a constant force bends
_DAMPING_N_S_PER_MM = 0.02  # of the driven side, while a force pushes it through its play
_STILL_RAD = 1e-9  # less is none: a tip that stands still is not looked at again


class Play:
    """A coupling with play: the driven side follows once the play is used up."""

    def __init__(self, half: float, at: float) -> None:
        self._half = half
        self.at = at

    def follow_all(self, driving: Iterable[float]) -> None:
        """`follow` the driving side through places in a row."""
        at, half = self.at, self._half
        for place in driving:
            if place - at > half:
                at = place - half
            elif place - at < -half:
                at = place + half
        self.at = at

    def follow(self, driving: float) -> float:
        """Move on with the driving side."""
        if driving - self.at > self._half:
            self.at = driving - self._half
        elif driving - self.at < -self._half:
            self.at = driving + self._half
        return self.at

    def push_to(self, place: float, driving: float) -> None:
        """Push the driven side towards a place, as far as the play lets it go."""
        self.at = min(max(place, driving - self._half), driving + self._half)


@dataclass(frozen=True)
class JointYield:
    """How a joint gives way to a force on the tip that it carries.

    `rad_per_nmm`: elastic turn for a torque of 1 N mm. `play_holds_n`: up to this force on the tip, across
    its lever, friction keeps the joint where it is within its play.
    """

    rad_per_nmm: float
    play_holds_n: float


class Joint:
    """A joint that a servo drives and a tip's force turns; `yields` None: the force does not move it."""

    def __init__(
        self, play_rad: float, driving_rad: float, yields: JointYield | None, stiffness_n_per_mm: float
    ) -> None:
        """`stiffness_n_per_mm`: of the tip, which takes the force away as the joint gives way."""
        self.yields = yields
        self._play = Play(play_rad, driving_rad)
        self._stiffness = stiffness_n_per_mm
        self._bend_rad = 0.0

    @property
    def at(self) -> float:
        """True angle."""
        return self._play.at + self._bend_rad

    def step(self, dt_s: float, driving_rad: float, push_n: float, lever_mm: float) -> None:
        """Follow the servo's side, and give way to a force on the tip: `push_n`, positive counter-clockwise.

        `lever_mm`: from the joint to the tip; the force is the component across it.
        """
        if self.yields is not None:
            self._bend(dt_s, self.yields.rad_per_nmm, push_n, lever_mm)
            beyond_n = max(abs(push_n) - self.yields.play_holds_n, 0.0)
            if beyond_n and lever_mm > 0:
                moved_mm = beyond_n * dt_s / (_DAMPING_N_S_PER_MM + self._stiffness * dt_s)
                turned = moved_mm / lever_mm if push_n > 0 else -moved_mm / lever_mm
                self._play.push_to(self._play.at + turned, driving_rad)
        self._play.follow(driving_rad)

    @property
    def is_straight(self) -> bool:
        """Whether it only follows the servo's side until a force on the tip bends it."""
        return self._bend_rad == 0.0

    def follow_all(self, driving_rad: Iterable[float]) -> None:
        """Follow the servo's side through angles in a row, as `step` does while straight and unloaded."""
        self._play.follow_all(driving_rad)

    def _bend(self, dt_s: float, rad_per_nmm: float, push_n: float, lever_mm: float) -> None:
        # As it bends on, a tip in contact is pushed by its stiffness times that way less.
        share = dt_s / _LAG_S
        stiffness = self._stiffness if push_n else 0.0
        missing = rad_per_nmm * lever_mm * push_n - self._bend_rad
        change = share * missing / (1 + share * (1 + stiffness * rad_per_nmm * lever_mm**2))
        if abs(change) > _STILL_RAD:
            self._bend_rad += change
        elif push_n == 0.0:
            self._bend_rad = 0.0
