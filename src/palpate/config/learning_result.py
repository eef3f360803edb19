"""Result of `palpate objects learn`, format `palpate/learning@1`."""

from typing import Literal

from palpate.base.vocabulary import IdentificationVerdict, RunLimit
from palpate.config.fields import Out, Rounded


class LearningOut(Out):
    """Outcome of learning: `tolerance` (mm) of the model, null if there is none; `goal`: what was asked.

    `fits_together`: false if touches contradict one another. `limit`: the limit that ended it. `verdict`: of
    the recognition among objects that were known, null if there was none; `objects`: which it may be.
    `state`: the way that it lies.
    """

    format: Literal["palpate/learning@1"]
    name: str
    state: str
    tolerance: Rounded | None
    goal: Rounded
    goal_met: bool
    fits_together: bool
    limit: RunLimit | None
    grips: int
    touches: int
    rig_seconds: Rounded
    verdict: IdentificationVerdict | None
    objects: tuple[str, ...]
