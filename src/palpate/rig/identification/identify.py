"""Identification by grips that are carried out: by a hand, or by whatever function gives their touches."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from palpate.base.vocabulary import Strategy
from palpate.config import RigFile
from palpate.recognizer import Catalogue, FingerApproach, Goals
from palpate.rig.identification.events import Observers, StageEvent
from palpate.rig.identification.grip_choice import GripChooser, PushTables, strategy_rng
from palpate.rig.identification.loop import OwnChoice, Search
from palpate.rig.identification.outcome import Identification
from palpate.rig.identification.part_count import PartCount
from palpate.rig.identification.several_parts import SeveralSearch
from palpate.rig.motion.guarded_approach import GripPhase, carry_out_grip
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import Reach, reach_of

GripExecutor = Callable[[Sequence[FingerApproach], Callable[[GripPhase], None]], Sequence[Touch]]
"""Carries out a grip and reports its stages."""


def identify(
    hand: Hand,
    catalogue: Catalogue,
    observers: Observers | None = None,
    *,
    strategy: Strategy = Strategy.PLANNED,
    seed: int = 0,
    own: OwnChoice | None = None,
    parts: PartCount | None = None,
) -> Identification:
    """Touch until there is one answer, as finely placed as the rig file's goals ask, or none to be had.

    `seed` decides what the strategy `random` draws; `own` chooses in its place. `parts`: how many lie on the
    table, None: one. The hand must be prepared. Raises what `carry_out_grip` raises, and OutputError before a
    grip once an observer has raised.
    """
    observers, reach = observers or Observers(), reach_of(hand.rig)
    search: Search | SeveralSearch
    if parts is None or parts.is_single:
        search = begin_search(hand.rig, reach, catalogue, observers, strategy, seed, own)
    else:
        single = begin_search(hand.rig, reach, catalogue, None, strategy, seed)
        search = SeveralSearch(single, parts, observers)
    return run_search(search, partial(carry_out_grip, hand), observers, hand.clock.now)


def search(
    rig: RigFile,
    reach: Reach,
    execute: GripExecutor,
    catalogue: Catalogue,
    observers: Observers | None = None,
    *,
    strategy: Strategy = Strategy.PLANNED,
    seed: int = 0,
) -> Identification:
    """Identify as `identify` does, with a function that carries out grips, whatever time they take."""
    observers = observers or Observers()
    return run_search(begin_search(rig, reach, catalogue, observers, strategy, seed), execute, observers)


def begin_search(
    rig: RigFile,
    reach: Reach,
    catalogue: Catalogue,
    observers: Observers | None = None,
    strategy: Strategy = Strategy.PLANNED,
    seed: int = 0,
    own: OwnChoice | None = None,
) -> Search:
    """A search that has no grips yet."""
    pushes = PushTables.of(rig, catalogue)
    chooser = GripChooser(rig, reach, strategy, strategy_rng(seed), None, {catalogue: pushes.stability})
    return Search(chooser, catalogue, pushes.bounds, observers, own)


def with_goals(chooser: GripChooser, goals: Goals | None) -> GripChooser:
    """The chooser with these goals; None: those of the rig file."""
    if goals is None:
        return chooser
    degrees = math.degrees(goals.orientation_rad)
    finer = {"goal_position_mm": goals.position_mm, "goal_orientation_deg": degrees}
    limits = chooser.rig.search.model_copy(update=finer)
    return replace(chooser, rig=chooser.rig.model_copy(update={"search": limits}))


def search_with(
    chooser: GripChooser,
    execute: GripExecutor,
    catalogue: Catalogue,
    pushes: PushTables,
    observers: Observers | None = None,
    now: Callable[[], float] = lambda: 0.0,
) -> Identification:
    """Search as `search` does, with what may be prepared once for many searches of a rig and a catalogue.

    `now`: the rig's clock (s), by which `max_seconds` counts.
    """
    observers = observers or Observers()
    return run_search(Search(chooser, catalogue, pushes.bounds, observers), execute, observers, now)


def run_search(
    search: Search | SeveralSearch,
    execute: GripExecutor,
    observers: Observers,
    now: Callable[[], float] = lambda: 0.0,
) -> Identification:
    """Carry out the grips that a search asks for until it has a verdict, or the rig's limits are reached."""
    verdict, limit, begun_s = None, None, now()
    search.prepare()
    while verdict is None and limit is None:
        verdict, grip = search.next()
        if verdict is None:
            observers.check()
            tell = partial(_tell_stage, observers, len(search.made_grips) + 1)
            search.take(grip, tuple(execute(grip, tell)))
            limit = search.limit(now() - begun_s)
    return search.conclude(verdict, limit)


def _tell_stage(observers: Observers, grip: int, stage: GripPhase) -> None:
    observers(StageEvent(grip, stage))
