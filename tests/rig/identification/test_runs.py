"""Whole identifications: how they end, a campaign, models of servos."""

import math
import random
from dataclasses import dataclass, replace
from functools import partial

import pytest

from palpate.base.vocabulary import IdentificationVerdict, RecognitionVerdict, Strategy
from palpate.config import ObjectsFile, RigFile, load_objects, shipped_objects
from palpate.config.rig_servos import BUILT_IN_MODELS
from palpate.drivers.dynamixel.models import specification
from palpate.recognizer import Catalogue
from palpate.rig.bench import connect
from palpate.rig.emulated.ground_truth import compare_answer
from palpate.rig.emulated.scene import Placement, outline_at
from palpate.rig.identification.events import Event, Observer, Observers, TouchEvent
from palpate.rig.identification.identify import identify
from palpate.rig.identification.outcome import Identification
from support.benches.rigs import firm_rig, small_objects, small_rig
from support.benches.session import EmulatedSession, emulated_session, identify_checked
from support.campaign.sampling import sample
from support.commands.repository import SHARED_OUTLINES, needs_shared_outlines

# ----------------------------------------------------------------------------------------------------
# How `identify` ends on emulated devices: moved parts, unknown parts, the other strategies.

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
def test_a_part_that_is_pushed_between_grips_is_noticed() -> None:
    before = placement_of("tee")
    session = emulated_session(seed=21, rig=RIG, placement=before)
    pusher = Pusher(session, before, 1)
    result = ended(session, record=pusher)
    assert result.moved_before == (2,)
    assert result.outcome is IdentificationVerdict.IDENTIFIED
    assert result.recognition is not None
    assert compare_answer(pusher.placement, result.recognition.hypotheses).inside_bounds
    assert not compare_answer(before, result.recognition.hypotheses).inside_bounds


@pytest.mark.slow
@pytest.mark.parametrize("name", sample(["ell", "tee"], []))
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
def test_wires_that_flip_and_lose_change_no_answer() -> None:
    assert RIG.emulation is not None
    bad = RIG.emulation.model_copy(update={"flipped_bytes": 0.0005, "lost_packets": 0.005})
    session = emulated_session(seed=3, rig=RIG.model_copy(update={"emulation": bad}), objects=OBJECTS)
    result = identify_checked(session, Catalogue(OBJECTS.objects))
    assert result.outcome is IdentificationVerdict.IDENTIFIED


# ----------------------------------------------------------------------------------------------------
# Whole runs over objects, places and seeds: right every time, and the truth inside the bounds every time.

NAMES = ("tr-1", "tr-2", "tr-3", "grip", "gator", "hand")
RUNS = [(name, 11 + k % 2) for k, name in enumerate(NAMES)]
PLACES = {11: (12.0, -7.0, 2.5), 12: (-15.0, 9.0, -0.7)}


@pytest.fixture(scope="module")
def shipped() -> tuple[ObjectsFile, Catalogue]:
    objects = load_objects(shipped_objects())
    return objects, Catalogue(objects.objects)


@pytest.fixture(scope="module")
def real_parts() -> tuple[ObjectsFile, Catalogue]:
    objects = load_objects(SHARED_OUTLINES)
    return objects, Catalogue(objects.objects)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seed"), sample(RUNS, RUNS[2:3]))
def test_shipped_objects(shipped: tuple[ObjectsFile, Catalogue], name: str, seed: int) -> None:
    objects, catalogue = shipped
    (model,) = [item for item in objects.objects if item.name == name]
    session = emulated_session(seed=seed, placement=Placement(model, model.states[0], *PLACES[seed]))
    result = identify_checked(session, catalogue)
    assert result.outcome is IdentificationVerdict.IDENTIFIED
    assert result.recognition is not None
    (only,) = result.recognition.hypotheses
    assert only.state.object_name == name
    assert session.placement is not None
    found = compare_answer(session.placement, [only])
    assert found.position_error_mm is not None
    assert found.orientation_error_rad is not None
    assert found.position_error_mm < 1.0
    assert found.orientation_error_rad < math.radians(1.0)


@pytest.mark.slow
@needs_shared_outlines
@pytest.mark.parametrize("seed", sample([1, 3], []))
def test_real_parts_among_all_of_them(real_parts: tuple[ObjectsFile, Catalogue], seed: int) -> None:
    """129 outlines, some of them twins that no touch can tell apart."""
    objects, catalogue = real_parts
    session = emulated_session(seed=seed, objects=objects)
    result = identify_checked(session, catalogue)
    assert result.recognition is not None
    if result.outcome is IdentificationVerdict.UNRESOLVED:  # no way is left to confirm what alone agrees
        assert result.recognition.verdict is RecognitionVerdict.UNIQUE
        return
    assert result.outcome in (IdentificationVerdict.IDENTIFIED, IdentificationVerdict.INDISTINGUISHABLE)


# ----------------------------------------------------------------------------------------------------
# Whole runs on rigs of other servos: whichever models aim and slide are, the truth is inside the bounds.


def drawn_pairs() -> list[tuple[str, str]]:
    """(aim, slide): every model once as either, in an order drawn by a fixed seed."""
    rng = random.Random(25)
    aims, slides = list(BUILT_IN_MODELS), list(BUILT_IN_MODELS)
    rng.shuffle(aims)
    rng.shuffle(slides)
    return list(zip(aims, slides, strict=True))


PAIRS = [("XH430-W350", "XH430-W350"), ("XM540-W270", "XC330-T288"), *drawn_pairs()]
KEPT = random.Random(25).sample(PAIRS, 1)
_STRONG_NM = 9.0


def with_servos(rig: RigFile, aim: str, slide: str) -> RigFile:
    """The same rig with these models in every finger.

    A strong servo's gear holds a slide of 100 mm a turn against all that max_force_n lets it do, and the run
    ends by saying so: it gets a larger pulley.
    """
    longer = 2.0 if specification(slide).motor.stall_torque_nm > _STRONG_NM else 1.0
    fingers = [
        finger.model_copy(
            update={
                "aim": finger.aim.model_copy(update={"model": aim}),
                "slide": finger.slide.model_copy(
                    update={"model": slide, "mm_per_turn": longer * finger.slide.mm_per_turn}
                ),
            }
        )
        for finger in rig.fingers
    ]
    return rig.model_copy(update={"fingers": fingers})


@pytest.mark.parametrize(("aim", "slide"), sample(PAIRS, KEPT))
def test_a_run_is_right_whatever_the_servos(aim: str, slide: str) -> None:
    objects = small_objects()
    session = emulated_session(seed=7, rig=with_servos(small_rig(firm_rig()), aim, slide), objects=objects)
    result = identify_checked(session, Catalogue(objects.objects))
    assert result.outcome is IdentificationVerdict.IDENTIFIED
