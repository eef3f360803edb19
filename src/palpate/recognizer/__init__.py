"""Pure computation: from contacts to hypotheses, and from hypotheses to the next approach.

Usable alone by someone who has no rig: arrays in, values out, no I/O, no clock, no devices.
"""

from palpate.recognizer.budget import STANDARD_BUDGET, Budget
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.confirmation import Confirmation, checking_grip
from palpate.recognizer.contact import Contact, Finger, NormalRange
from palpate.recognizer.evidence import detectable_shift_mm, recognised_shift_mm
from palpate.recognizer.explanation import is_explained
from palpate.recognizer.grips import FREE_MARGIN_MM, FingerApproach, Grip, Reachable, twins
from palpate.recognizer.hypotheses import Bounds, Configuration, Hypothesis, Slide
from palpate.recognizer.measurement_model import Resolution
from palpate.recognizer.motion import Motion, carried_by, felt_in_motion
from palpate.recognizer.pad_face import beside, face_offsets_mm
from palpate.recognizer.planner import plan_grip
from palpate.recognizer.poses import Goals
from palpate.recognizer.prediction import Prediction, Predictions, predict
from palpate.recognizer.push_limits import PushLimits
from palpate.recognizer.rays import Approach
from palpate.recognizer.recognition import PossibleState, Recognition, recognise
from palpate.recognizer.strangers import StrangerEvidence, stranger_terms
from palpate.recognizer.strategy import already_used, next_grip

__all__ = [
    "FREE_MARGIN_MM",
    "STANDARD_BUDGET",
    "Approach",
    "Bounds",
    "Budget",
    "Catalogue",
    "Configuration",
    "Confirmation",
    "Contact",
    "Finger",
    "FingerApproach",
    "Goals",
    "Grip",
    "Hypothesis",
    "Motion",
    "NormalRange",
    "PossibleState",
    "Prediction",
    "Predictions",
    "PushLimits",
    "Reachable",
    "Recognition",
    "Resolution",
    "Slide",
    "StrangerEvidence",
    "already_used",
    "beside",
    "carried_by",
    "checking_grip",
    "detectable_shift_mm",
    "face_offsets_mm",
    "felt_in_motion",
    "is_explained",
    "next_grip",
    "plan_grip",
    "predict",
    "recognise",
    "recognised_shift_mm",
    "stranger_terms",
    "twins",
]
