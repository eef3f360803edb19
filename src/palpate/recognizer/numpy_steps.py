"""Search steps with NumPy: reference for the compiled steps, and fallback where there is no compiler."""

from palpate.recognizer.model_test import narrow
from palpate.recognizer.numpy_cells import (
    cut_cells,
    divide_cells,
    free_cells,
    position_boxes,
    refine_intervals,
)
from palpate.recognizer.numpy_pairing import extend, second_level, third_level
from palpate.recognizer.numpy_regions import search_round
from palpate.recognizer.numpy_stops import enclose_stops
from palpate.recognizer.numpy_witnesses import can_be_verified, sift_intervals, sift_parts

__all__ = [
    "can_be_verified",
    "cut_cells",
    "divide_cells",
    "enclose_stops",
    "extend",
    "free_cells",
    "narrow",
    "position_boxes",
    "refine_intervals",
    "search_round",
    "second_level",
    "sift_intervals",
    "sift_parts",
    "third_level",
]
