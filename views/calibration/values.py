"""What the pictures of a calibration show, as plain values; mm and rad in W.

Between the calibration file and the drawings, so that these know nothing of files.
"""

from dataclasses import dataclass

from palpate.views.scene.style import HUES, TRUTH
from palpate.views.scene.values import FingerBase
from palpate.views.svg import Floats

__all__ = ["FINGER_HUES", "MEASURED", "NEVER_PRESSED", "Mark", "MarkMap", "Spread", "TaxelMap"]

FINGER_HUES = tuple(hue for hue in HUES if hue != TRUTH)
"""Colours of fingers, one after the other; what was left out has a colour of its own."""

MEASURED, NEVER_PRESSED = "measured", "never pressed"


@dataclass(frozen=True)
class Mark:
    """A touch of a reference: whose (index of the finger), of which placing, where, and how far off.

    `residual_mm` > 0: the tip stood further out along the reference's outward normal than the fit says.
    """

    finger: int
    placing: int
    at_mm: tuple[float, float]
    normal_rad: float
    residual_mm: float
    held_out: bool
    outlier: bool


@dataclass(frozen=True)
class MarkMap:
    """All touches in plan view. `names`: the fingers' names in the order of `Mark.finger`."""

    names: tuple[str, ...]
    bases: tuple[FingerBase, ...]
    marks: tuple[Mark, ...]


@dataclass(frozen=True, eq=False)
class Spread:
    """Residuals (n,) mm of a finger, those that were fitted and those held out; outliers are only counted.

    `bound_mm`: the bound on positions that is stated for it, None for none.
    """

    name: str
    fitted_mm: Floats
    held_out_mm: Floats
    outliers: int
    bound_mm: float | None


@dataclass(frozen=True, eq=False)
class TaxelMap:
    """Relative gains (rows, cols) of an array, row 0 at the tip's lower end, and their bounds as shares.

    `kinds`, row by row: `MEASURED`, `NEVER_PRESSED`, or what is wrong with a taxel, such as "dead".
    """

    name: str
    gain: Floats
    gain_bound: Floats
    kinds: tuple[tuple[str, ...], ...]
