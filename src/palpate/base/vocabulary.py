"""Closed sets of words shared by files, results, the command line and computations: one enum per concept.

This module imports nothing, so that the command line can list the values without loading computing modules.
"""

from enum import StrEnum
from typing import Final

DEFAULT_BUDGET = 1_000_000
LEAST_BUDGET = 10_000
"""Units of work for one recognition (docs/recogniser.md, "The work budget")."""


SESSIONS_FOLDER = "palpate-sessions"
"""In which commands keep the sessions of runs, where they are started."""


class SessionKind(StrEnum):
    """Purpose of a session, as its log's `command` says."""

    IDENTIFY = "identify"
    CONNECT = "connect"
    LEARN = "learn"


class RecognitionVerdict(StrEnum):
    """Number of hypotheses that explain the contacts (docs/recogniser.md, "Hypotheses")."""

    UNIQUE = "unique"
    AMBIGUOUS = "ambiguous"
    NONE = "none"


class IdentificationVerdict(StrEnum):
    """Result of a run on the bench."""

    IDENTIFIED = "identified"
    INDISTINGUISHABLE = "indistinguishable"
    UNKNOWN = "unknown"
    UNRESOLVED = "unresolved"
    MOVING = "moving"

    @property
    def is_answer(self) -> bool:
        """True if it names what lies on the table."""
        return self in (IdentificationVerdict.IDENTIFIED, IdentificationVerdict.INDISTINGUISHABLE)


class ContradictionCause(StrEnum):
    """Reason why nothing in a catalogue explains grips together; the last where touches do not say which."""

    MOVED = "moved"
    NOT_IN_CATALOGUE = "not-in-catalogue"
    EITHER = "either"


class Strategy(StrEnum):
    """Choice of the next grip (memo §3.2)."""

    PLANNED = "planned"
    RANDOM = "random"
    ROTATE = "rotate"


OWN_STRATEGY: Final = "own"
"""Name, in results and logs, of a strategy that is a function of Python."""


class PushResponse(StrEnum):
    """Behaviour of a part in one of its states when it is pushed; one that slides does nothing else."""

    SLIDES = "slides"
    MAY_TIP = "may-tip"
    MAY_ROLL = "may-roll"


class SetUpFault(StrEnum):
    """What may be wrong with a rig's file or its wiring, as contacts that fit nothing may show."""

    ARRAY_MIRRORED = "array-mirrored"
    ARRAY_TURNED = "array-turned"
    ARRAY = "array"
    JOINT_SIGN = "joint-sign"
    JOINT_OFFSET = "joint-offset"
    TRAVEL_SCALE = "travel-scale"
    FRAME_MIRRORED = "frame-mirrored"
    TIP_SIZE = "tip-size"
    FINGER = "finger"


class RunLimit(StrEnum):
    """Limit of a rig file that ended an identification though another grip was wanted."""

    MAX_GRIPS = "max_grips"
    MAX_SECONDS = "max_seconds"


class BoundSource(StrEnum):
    """Source of an answer's bounds: where tips are, their dents, normals, motion, the part's tolerance."""

    FINGERS = "fingers"
    DENTS = "dents"
    NORMALS = "normals"
    MOTION = "motion"
    TOLERANCE = "tolerance"


class PartMotion(StrEnum):
    """Assumption on whether fingers move the parts that they push."""

    STILL = "still"
    MOVING = "moving"


class ErrorSource(StrEnum):
    """Source of error that limits how well a rig tells parts apart.

    How far off contacts are, how wide their ranges of normals, how far parts are from their models, from
    which sides fingers reach them, and that parts move when they are touched.
    """

    POSITION = "position"
    NORMAL = "normal"
    TOLERANCE = "tolerance"
    REACH = "reach"
    MOTION = "motion"
