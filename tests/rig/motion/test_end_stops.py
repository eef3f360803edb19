"""Hard stops of emulated slides: a servo of little current stalls there, and coming back shows the play."""

import math

import pytest
from servo_console import Console

from palpate.drivers.emulators.mechanics import FingerTruth, SlideMechanics
from palpate.drivers.emulators.servo import EmulatedServo

STOPS = (43.0, 60.0)
PLAY = 0.15
STIFFNESS = 2000.0
CURRENT = 30
# 30 units of 2.69 mA of a motor with 4.1 Nm at 2.3 A (e-Manual), at 100 mm per turn; 0.05 Nm of friction.
FORCE = CURRENT * 2.69e-3 * 4.1 / 2.3 * 2 * math.pi / 0.1
FRICTION = 0.05 * 2 * math.pi / 0.1


class Slide:
    """A slide at aim 0 along x, whose servo is driven in Current-based Position Control Mode."""

    def __init__(self, model: str = "XM430-W350", mm_per_turn: float = 100.0) -> None:
        mm_per_rad = mm_per_turn / (2 * math.pi)
        self.console = Console(model=model, start_rad=(50.0 - 90.0) / mm_per_rad)
        self.truth = FingerTruth(
            base_mm=(0.0, 0.0),
            heading_rad=0.0,
            height_mm=10.0,
            gear_ratio=5.0,
            aim_zero_rad=0.0,
            aim_play_rad=0.0,
            mm_per_rad=mm_per_rad,
            zero_mm=90.0,
            slide_play_mm=PLAY,
            tip_radius_mm=5.0,
            stiffness_n_per_mm=3.0,
            array_heading_rad=0.0,
            stops_mm=STOPS,
        )
        self.mechanics = SlideMechanics(self.truth, EmulatedServo(2), self.console.servo)
        self.console.start(5, current=CURRENT, velocity=50)

    @property
    def carriage(self) -> float:
        return float(self.mechanics.centre_mm[0])

    @property
    def drive(self) -> float:
        """Where the tip would be without play, as an exact encoder would tell."""
        return self.truth.zero_mm + self.truth.mm_per_rad * self.console.servo.shaft_rad

    def go(self, distance: float, seconds: float) -> list[tuple[float, float]]:
        """Drive towards a distance; drive and carriage every millisecond."""
        tick = 2048 + (distance - self.truth.zero_mm) / self.truth.mm_per_rad * 4096 / (2 * math.pi)
        assert self.console.write(116, round(tick), 4) == 0
        seen = []
        for _ in range(round(seconds * 1000)):
            self.mechanics.step(1e-3, None)
            seen.append((self.drive, self.carriage))
        return seen


@pytest.mark.parametrize(("goal", "stop", "outward"), [(30.0, STOPS[0], -1), (75.0, STOPS[1], 1)])
def test_a_servo_of_little_current_stalls_at_the_stop(goal: float, stop: float, outward: int) -> None:
    slide = Slide()
    slide.go(goal, 2.0)
    before = slide.carriage
    slide.go(goal, 0.5)
    assert slide.carriage == pytest.approx(before, abs=1e-6), "it stands"
    deep = outward * (slide.carriage - stop)
    assert (FORCE - FRICTION) / STIFFNESS <= deep <= (FORCE + FRICTION) / STIFFNESS
    # The stop pushes back, so the play is all on one side.
    assert slide.drive - slide.carriage == pytest.approx(outward * PLAY)


def test_coming_back_shows_the_play() -> None:
    slide = Slide()
    slide.go(30.0, 2.0)
    pressed = slide.drive
    way = slide.go(50.0, 2.0)
    still = [drive for drive, carriage in way if carriage <= STOPS[0]]
    # The drive has gone through the play both ways before it takes the carriage along.
    assert max(still) - pressed == pytest.approx(2 * PLAY, abs=0.05)
    assert min(carriage for _, carriage in way) >= STOPS[0] - (FORCE + FRICTION) / STIFFNESS
    drive, carriage = way[-1]
    assert drive == pytest.approx(50.0, abs=0.3)
    assert drive - carriage == pytest.approx(PLAY)


def test_no_push_where_there_is_no_stop() -> None:
    slide = Slide()
    slide.go(45.0, 2.0)
    assert slide.carriage == pytest.approx(45.0 + PLAY, abs=0.3)
    assert slide.carriage - slide.drive == pytest.approx(PLAY)


@pytest.mark.parametrize("model", ["XL330-M288", "XC330-M288", "XM430-W350"])
@pytest.mark.parametrize("mm_per_turn", [-100.0, 40.0, 200.0])
def test_slides_of_every_kind_come_to_rest_at_their_stops(model: str, mm_per_turn: float) -> None:
    slide = Slide(model, mm_per_turn)
    way = slide.go(30.0, 2.0)
    assert min(carriage for _, carriage in way) > STOPS[0] - 0.5
    assert {round(carriage, 4) for _, carriage in way[-500:]} == {round(slide.carriage, 4)}
    assert slide.carriage == pytest.approx(STOPS[0], abs=0.05)
