"""Whole runs on rigs of other servos: whichever models aim and slide are, the truth is inside the bounds."""

import random

import pytest
from emulated_session import emulated_session, identify_checked
from quick_rig import small_objects, small_rig
from sampling import sample

from palpate.base.vocabulary import IdentificationVerdict
from palpate.config import RigFile
from palpate.config.rig_servos import BUILT_IN_MODELS
from palpate.drivers.dynamixel.models import specification
from palpate.recognizer import Catalogue


def drawn_pairs() -> list[tuple[str, str]]:
    """(aim, slide): every model once as either, in an order drawn by a fixed seed."""
    rng = random.Random(25)
    aims, slides = list(BUILT_IN_MODELS), list(BUILT_IN_MODELS)
    rng.shuffle(aims)
    rng.shuffle(slides)
    return list(zip(aims, slides, strict=True))


PAIRS = [("XH430-W350", "XH430-W350"), ("XM540-W270", "XC330-T288"), *drawn_pairs()]
KEPT = random.Random(25).sample(PAIRS, 3)
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
    session = emulated_session(seed=7, rig=with_servos(small_rig(), aim, slide), objects=objects)
    result = identify_checked(session, Catalogue(objects.objects))
    assert result.outcome is IdentificationVerdict.IDENTIFIED
