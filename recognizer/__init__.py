"""Pure computation: from contacts to hypotheses, and from hypotheses to the next approach.

Usable alone by someone who has no rig: arrays in, values out, no I/O, no clock, no devices.
"""

from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact, Finger, NormalRange
from palpate.recognizer.hypotheses import Bounds, Configuration, Hypothesis, Slide
from palpate.recognizer.model import ObjectModel, Polygon, Section, State
from palpate.recognizer.planner import Candidate, Grip, Prediction, Resolution, plan_grip, predict, separable
from palpate.recognizer.recognise import Recognition, Verdict, recognise
from palpate.recognizer.sweep import Approach

__all__ = [
    "Approach",
    "Bounds",
    "Candidate",
    "Catalogue",
    "Configuration",
    "Contact",
    "Finger",
    "Grip",
    "Hypothesis",
    "NormalRange",
    "ObjectModel",
    "Polygon",
    "Prediction",
    "Recognition",
    "Resolution",
    "Section",
    "Slide",
    "State",
    "Verdict",
    "plan_grip",
    "predict",
    "recognise",
    "separable",
]
