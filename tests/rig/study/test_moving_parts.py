"""Studies of parts that fingers move: how far, that the truth is never lost, and what rig files say of it."""

import numpy as np
import pytest
from repository import EXAMPLES
from sampling import sample

from palpate.base.errors import InputError
from palpate.base.vocabulary import IdentificationVerdict, PartMotion, Strategy
from palpate.config import RigFile, load_objects, load_rig, shipped_objects, shipped_rig
from palpate.config.emulation import EmulatedPartConfig
from palpate.jobs.study import study
from palpate.rig.study.simulation import Simulation, motion_of, with_motion
from palpate.rig.study.summary import is_wrong

RIG, SIX = load_rig(shipped_rig()), load_objects(shipped_objects())


def of_mass(mass_kg: float) -> RigFile:
    """The shipped rig with a part of a mass."""
    assert RIG.emulation is not None
    part = EmulatedPartConfig(engine="quasi-static", mass_kg=mass_kg, friction=0.3, tip_friction=0.5)
    return RIG.model_copy(update={"emulation": RIG.emulation.model_copy(update={"part": part})})


@pytest.mark.parametrize("runs", sample([12, 300], [12]))
def test_the_truth_is_never_lost_although_parts_are_pushed(runs: int) -> None:
    some = Simulation(*with_motion(RIG, SIX, PartMotion.MOVING), Strategy.PLANNED, 4)
    rows = [some.run(number) for number in range(runs)]
    assert [row for row in rows if not row.inside_bounds] == []
    assert not any(map(is_wrong, rows))
    assert sum(row.verdict is IdentificationVerdict.IDENTIFIED for row in rows) >= 0.9 * runs
    again = Simulation(*with_motion(RIG, SIX, PartMotion.MOVING), Strategy.PLANNED, 4)
    assert again.run(runs - 1) == rows[-1], "a run depends on its number only"


def test_a_light_part_is_moved_a_heavy_one_is_not_and_one_that_is_held_neither() -> None:
    def moved(rig: RigFile, motion: PartMotion) -> list[float]:
        some = Simulation(*with_motion(rig, SIX, motion), Strategy.PLANNED, 2)
        return [some.run(number).moved for number in range(4)]

    light, heavy = (moved(of_mass(mass), PartMotion.MOVING) for mass in (0.03, 20.0))
    assert min(light) > 0.005
    assert max(heavy) < 1e-9
    assert moved(of_mass(0.03), PartMotion.STILL) == [0.0] * 4


def test_a_part_that_moves_takes_more_touches_and_is_found_less_finely() -> None:
    """The same parts at the same places."""
    still, moving = (
        [Simulation(*with_motion(RIG, SIX, motion), Strategy.PLANNED, 1).run(k) for k in range(10)]
        for motion in PartMotion
    )
    assert [(run.object, run.state) for run in still] == [(run.object, run.state) for run in moving]
    both = [(one.position_bound, other.position_bound) for one, other in zip(still, moving, strict=True)]
    bounds = np.array([pair for pair in both if None not in pair], dtype=float)
    assert np.median(bounds[:, 0]) < np.median(bounds[:, 1])
    assert sum(run.touches for run in still) < sum(run.touches for run in moving)


def test_whether_parts_move_is_as_the_rig_file_says_or_as_asked() -> None:
    assert motion_of(RIG) is PartMotion.MOVING
    held, objects = with_motion(RIG, SIX, PartMotion.STILL)
    assert motion_of(held) is PartMotion.STILL
    assert held.search.part_holds_n is None
    assert [item.holds_n for item in objects.objects] == [None] * 6
    assert motion_of(with_motion(held, objects, PartMotion.MOVING)[0]) is PartMotion.MOVING


def test_a_real_rig_is_studied_with_parts_that_lie_still_only() -> None:
    rig = load_rig(EXAMPLES / "real-rig.toml")
    with pytest.raises(InputError, match="describes real devices, and nothing of parts that move"):
        study(rig, SIX, runs=2, parts="moving")
    out = study(rig, SIX, runs=2, budget=0)
    assert (out.parts, out.wrong, out.lost) == (PartMotion.STILL, 0, 0)


@pytest.mark.parametrize("given", [{"parts": "fast"}, {"strategy": "clever"}])
def test_an_unknown_word_is_refused_with_those_that_are_known(given: dict[str, str]) -> None:
    with pytest.raises(InputError, match=r'"(fast|clever)"; allowed: \w+, \w+'):
        study(RIG, SIX, runs=2, **given)  # type: ignore[arg-type]
