"""How `identify` ends on emulated devices: moved parts, unknown parts, the other strategies."""

from dataclasses import dataclass, replace
from functools import partial

import pytest
from emulated_session import EmulatedSession, emulated_session, identify_checked
from quick_rig import small_objects, small_rig
from sampling import sample

from palpate.base.vocabulary import IdentificationVerdict, Strategy
from palpate.config import ObjectsFile
from palpate.recognizer import Catalogue
from palpate.rig.bench import connect
from palpate.rig.emulated.ground_truth import compare_answer
from palpate.rig.emulated.scene import Placement, outline_at
from palpate.rig.identification.loop import Identification, identify
from palpate.rig.identification.observers import Event, Observer, Observers, TouchEvent

RIG, OBJECTS = small_rig(), small_objects()
PLACE = (6.0, -8.0, 1.1)


@dataclass
class Pusher:
    """Pushes the part by 5 mm once a grip is over."""

    session: EmulatedSession
    placement: Placement
    after: int

    def __call__(self, event: Event) -> None:
        if not isinstance(event, TouchEvent) or event.grip != self.after:
            return
        self.placement = replace(
            self.placement, x_mm=self.placement.x_mm + 4.0, y_mm=self.placement.y_mm - 3.0
        )
        self.session.bench.put(partial(outline_at, self.placement))


def placement_of(name: str) -> Placement:
    (model,) = [item for item in OBJECTS.objects if item.name == name]
    return Placement(model, model.states[0], *PLACE)


def ended(
    session: EmulatedSession,
    catalogue: ObjectsFile = OBJECTS,
    record: Observer | None = None,
    strategy: Strategy = Strategy.PLANNED,
) -> Identification:
    with connect(session.bench_rig) as hand:
        hand.prepare()
        result = identify(
            hand, Catalogue(catalogue.objects), Observers(record=record), strategy=strategy, seed=1
        )
    assert not any(session.torque().values())
    return result


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tee"])
def test_a_part_that_is_pushed_between_grips_is_noticed(name: str) -> None:
    session = emulated_session(seed=21, rig=RIG, placement=placement_of(name))
    pusher = Pusher(session, placement_of(name), 1)
    result = ended(session, record=pusher)
    assert result.moved_before == (2,)
    assert result.outcome is IdentificationVerdict.IDENTIFIED
    assert result.recognition is not None
    assert compare_answer(pusher.placement, result.recognition.hypotheses).inside_bounds
    assert not compare_answer(placement_of(name), result.recognition.hypotheses).inside_bounds


@pytest.mark.slow
@pytest.mark.parametrize("name", sample(["ell", "tee"], ["ell"]))
def test_a_part_outside_the_catalogue_is_not_named(name: str) -> None:
    """Unknown; or moving, where the last grip by itself happens to fit something."""
    others = ObjectsFile(tuple(item for item in OBJECTS.objects if item.name != name))
    result = ended(emulated_session(seed=22, rig=RIG, placement=placement_of(name)), others)
    assert result.recognition is not None
    if result.outcome is IdentificationVerdict.UNKNOWN:
        assert not result.recognition.hypotheses
        assert result.stranger_probability is None
    else:
        assert result.outcome is IdentificationVerdict.MOVING
        assert len(result.moved_before) == 2


@pytest.mark.slow
@pytest.mark.parametrize("strategy", sample([Strategy.RANDOM, Strategy.ROTATE], []))
def test_the_other_strategies_keep_the_truth(strategy: Strategy) -> None:
    result = ended(emulated_session(seed=23, rig=RIG, placement=placement_of("ell")), strategy=strategy)
    assert result.outcome in (IdentificationVerdict.IDENTIFIED, IdentificationVerdict.UNRESOLVED)
    assert result.recognition is not None
    assert compare_answer(placement_of("ell"), result.recognition.hypotheses).inside_bounds


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3])
def test_wires_that_flip_and_lose_change_no_answer(seed: int) -> None:
    assert RIG.emulation is not None
    bad = RIG.emulation.model_copy(update={"flipped_bytes": 0.0005, "lost_packets": 0.005})
    session = emulated_session(seed=seed, rig=RIG.model_copy(update={"emulation": bad}), objects=OBJECTS)
    result = identify_checked(session, Catalogue(OBJECTS.objects))
    assert result.outcome is IdentificationVerdict.IDENTIFIED
