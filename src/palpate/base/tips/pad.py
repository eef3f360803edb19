"""Pad: a flat face across the travel, whose contacts are given as points (docs/recogniser.md, "A pad")."""

from collections.abc import Sequence
from typing import ClassVar

from palpate.base.tips.cylinder import Cylinder
from palpate.base.tips.tip import Refusals


class Pad(Cylinder):
    """An upright flat face, its radius half of its width; it goes straight, and its points do."""

    shape = noun = "pad"
    has_face = True
    measures_normal = False
    corners_at_once = 2
    radius_words = "half of width_mm"
    needs: ClassVar = {
        "width_mm": 'the key "width_mm" is missing: a pad has that in place of radius_mm',
        "array.pitch_mm": 'the key "pitch_mm" is missing: how far apart the columns of a pad\'s array are at '
        "most",
    }
    lacks: ClassVar = {
        "max_latitude_deg": Cylinder.lacks["max_latitude_deg"],
        "max_friction": "must be 0 for pads: what friction does to their skin is not known",
        "array.heading_deg": "must be 0; a pad looks along the slide (0)",
        "array.coverage_deg": "is for cylinders and balls; flat arrays cover a pad's face",
        "bounds.direction_deg": "is for round tips: pads cannot be calibrated",
    }
    cannot: ClassVar[Refusals] = {
        "calibrate": "pads cannot be calibrated: measure the rig by hand and state its bounds (docs/pads.md)",
        "compare touches": "touches are compared with a calibration: pads are measured by hand",
        "plan": "files of contacts do not say which of them are of one touch; use palpate identify",
        "simulate": "simulated touches are those of cylinders; run palpate identify with seeds on an "
        "emulated rig instead",
        "check what parts hold": "where it pushes parts is not known well enough; parts must be held down "
        "under pads, so that part_holds_n is not needed",
        "move parts": "how pads move parts is not known",
        "turn on the way": "on an arm a pad turns as it travels, and palpate does not know how: use a "
        "cylinder or a ball, or slides",
    }

    def size_text(self, radius_mm: float, width_mm: float | None = None) -> str:  # noqa: ARG002
        """Width of one, to follow its noun."""
        return f"{2 * radius_mm:g} mm wide"

    def radius_of_width_mm(self, width_mm: float) -> float:
        """Half of the width."""
        return width_mm / 2

    def plan_mm(self, radius_mm: float, width_mm: float | None) -> Sequence[tuple[float, float]]:  # noqa: ARG002
        """Face, from edge to edge."""
        return ((0.0, -radius_mm), (0.0, radius_mm))
