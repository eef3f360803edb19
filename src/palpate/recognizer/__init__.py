"""Pure computation: from contacts to hypotheses, and from hypotheses to the next approach.

Usable without a rig: arrays in, values out, no I/O, no clock, no devices.
"""

from palpate.recognizer.approach import Approach, approach_lines, offset_from_lines
from palpate.recognizer.bound_sources import HalfWidths, MeasuredContact, widths_without_source
from palpate.recognizer.budget import STANDARD_BUDGET, Budget
from palpate.recognizer.catalogue import FACET_ERROR_MM, SYMMETRY_TOLERANCE_MM, Catalogue, prepare_states
from palpate.recognizer.contact import Contact, Finger, NormalRange
from palpate.recognizer.edges import CatalogueState
from palpate.recognizer.evidence import (
    StrangerEvidence,
    detectable_shift_mm,
    recognised_shift_mm,
    stranger_terms,
)
from palpate.recognizer.explanation import (
    ObjectExplanation,
    SearchTest,
    explain_object,
    grips_before_move,
    is_explained,
    suspected_contacts,
)
from palpate.recognizer.fewest_touches import fewest_touches
from palpate.recognizer.hypotheses import Bounds, Configuration, Hypotheses, Hypothesis, Slide
from palpate.recognizer.interpretations import LevelCount
from palpate.recognizer.memo_statistics import MemoCounts, memo_counts
from palpate.recognizer.pad_face import face_offsets_mm, point_to_left
from palpate.recognizer.planner import FREE_MARGIN_MM, FingerApproach, Grip, Reachable, plan_grip, twins
from palpate.recognizer.prediction import Prediction, Predictions, predict
from palpate.recognizer.preparation import (
    DIGEST_BYTES,
    Arrays,
    FingerPreparation,
    NamedArrays,
    PreparedStates,
    prepare_finger,
    state_digest,
)
from palpate.recognizer.recognition import (
    Motion,
    PossibleState,
    Recognition,
    contact_after_motion,
    contact_in_motion,
    narrow_first,
    recognise,
)
from palpate.recognizer.strategy import (
    Confirmation,
    confirmation_grip,
    extend_to_confirm,
    heuristic_grip,
    used_approaches,
)
from palpate.recognizer.symmetry import Symmetry, centroid, rotational_symmetry
from palpate.recognizer.tables import Table
from palpate.recognizer.tip_obstacle import ball_obstacle, is_exact
from palpate.recognizer.touch_model import Goals, PushLimits, Resolution, near_equal

__all__ = [
    "DIGEST_BYTES",
    "FACET_ERROR_MM",
    "FREE_MARGIN_MM",
    "STANDARD_BUDGET",
    "SYMMETRY_TOLERANCE_MM",
    "Approach",
    "Arrays",
    "Bounds",
    "Budget",
    "Catalogue",
    "CatalogueState",
    "Configuration",
    "Confirmation",
    "Contact",
    "Finger",
    "FingerApproach",
    "FingerPreparation",
    "Goals",
    "Grip",
    "HalfWidths",
    "Hypotheses",
    "Hypothesis",
    "LevelCount",
    "MeasuredContact",
    "MemoCounts",
    "Motion",
    "NamedArrays",
    "NormalRange",
    "ObjectExplanation",
    "PossibleState",
    "Prediction",
    "Predictions",
    "PreparedStates",
    "PushLimits",
    "Reachable",
    "Recognition",
    "Resolution",
    "SearchTest",
    "Slide",
    "StrangerEvidence",
    "Symmetry",
    "Table",
    "approach_lines",
    "ball_obstacle",
    "centroid",
    "confirmation_grip",
    "contact_after_motion",
    "contact_in_motion",
    "detectable_shift_mm",
    "explain_object",
    "extend_to_confirm",
    "face_offsets_mm",
    "fewest_touches",
    "grips_before_move",
    "heuristic_grip",
    "is_exact",
    "is_explained",
    "memo_counts",
    "narrow_first",
    "near_equal",
    "offset_from_lines",
    "plan_grip",
    "point_to_left",
    "predict",
    "prepare_finger",
    "prepare_states",
    "recognise",
    "recognised_shift_mm",
    "rotational_symmetry",
    "state_digest",
    "stranger_terms",
    "suspected_contacts",
    "twins",
    "used_approaches",
    "widths_without_source",
]
