"""Outcome of an identification: what is known when it ends, of one part or of several on one table."""

import math
from dataclasses import dataclass

from palpate.base.vocabulary import IdentificationVerdict, RunLimit
from palpate.recognizer import Hypothesis, Recognition
from palpate.rig.identification.contradiction import Contradiction
from palpate.rig.identification.motion_bounds import GripMotion
from palpate.rig.motion.touch import Touch


@dataclass(frozen=True, eq=False)
class TableParts:
    """Parts that were found on one table, each with what its own touches say, and the rest of the table.

    `agreed` (n,): every way that is left to divide the touches among parts, `divisions` of them, has this
    part with these touches. `is_complete`: there are as many as were asked for, or no state of the catalogue
    has room for one more. In the rest of the workspace nothing has a section at the heights `rest_z_mm` in
    which a circle of a larger radius than `rest_mm` fits.
    """

    parts: tuple["Identification", ...]
    agreed: tuple[bool, ...]
    divisions: int
    is_complete: bool
    rest_mm: float
    rest_z_mm: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Identification:
    """Result of a run. `grips` holds the touches of every grip; `ruled_out` what earlier grips allowed.

    `ruled_out` pairs each hypothesis with the number of the grip that ruled it out. `moved_before`: grips
    (from 1) before which the part seems to have been moved. `predicted`: touches that came out as everything
    that is left had predicted. `detectable_shift_mm`: a shift of the part by more before the last grip would
    have been detected for certain. `swept`: nothing was touched (since a move), and no state that fingers can
    feel has room in the rest of the workspace. `motions`: how far (mm, rad) each grip may have moved the
    part at most, None where that has no bound; empty if `assumed_holds_n` is None: the part is taken to lie
    still. `hold_contradicted`: it was moved by more than that force allows, or it is none of the catalogue.
    `stranger_probability`: that something outside the catalogue which agreed with the first contacts would
    have agreed with all touches since; None if nothing was predicted or nothing agrees;
    `altered_probability`: the same of what differs by less, in one feature of a part. `goal_met`: the
    answer is placed as finely as the rig's goals ask; None without an answer. `limit`: what the run
    came to before its goal. `contradictions`: grips that contradicted earlier ones, and what touches made
    again say of the reason. `table`: where several parts were sought, all of them; then the outcome is that
    of the table, and the rest is of the first part.
    """

    outcome: IdentificationVerdict
    recognition: Recognition | None
    grips: tuple[tuple[Touch, ...], ...]
    ruled_out: tuple[tuple[int, Hypothesis], ...]
    moved_before: tuple[int, ...] = ()
    predicted: int = 0
    detectable_shift_mm: float = math.inf
    swept: bool = False
    motions: tuple[tuple[float, float] | None, ...] = ()
    assumed_holds_n: float | None = None
    hold_contradicted: bool = False
    stranger_probability: float | None = None
    goal_met: bool | None = None
    limit: RunLimit | None = None
    contradictions: tuple[Contradiction, ...] = ()
    altered_probability: float | None = None
    grip_motions: tuple[GripMotion, ...] = ()
    table: TableParts | None = None

    @property
    def touches(self) -> int:
        """Approaches carried out, misses included."""
        return sum(len(grip) for grip in self.grips)
