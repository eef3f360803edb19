"""The memo's Tables I, II and III with figures of ours beside them: `python benchmarks/memo_tables.py`.

Three point fingers without errors and without normals, from evenly spaced directions, touch one object at a
time. The memo gives its shapes as drawings only. The six shipped objects have its names and edge counts, not
its coordinates, so the figures are alike at best. Of GRIPS seeded grips on an object, the one shown leaves
the median number of interpretations to the model test.

The example with twelve edges (memo §2.3) is an asymmetric polygon with notches. There the memo shows one
particular grip; out of SEARCHED seeded ones, the one shown comes closest to the memo's counts.
"""

import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.base.geometry import ObjectModel
from palpate.recognizer import Catalogue, Contact
from palpate.recognizer.memo_statistics import MemoCounts, memo_counts
from support.oracles.shapely_touches import SHIPPED_OBJECTS, flat, grip, outlines, place

GRIPS = 25
SEARCHED = 300
FAR_MM = 300.0  # fingers start outside of every object's hull

DISTANCE_FIRST = ("1", "2", "2D", "2A", "3", "3D", "3A", "M")
ANGLE_FIRST = ("1", "2", "2A", "2D", "3", "3A", "3D", "M")
EFFICIENCIES = ("D2", "A2", "DA2", "D3", "A3", "DA3")


@dataclass(frozen=True)
class Row:
    """One object's counts in both orders, (1, 2, 2D, 2A, 3, 3D, 3A, M) and (1, 2, 2A, 2D, 3, 3A, 3D, M)."""

    name: str
    distance_first: tuple[int, ...]
    angle_first: tuple[int, ...]


# As printed in the memo.
MEMO_ROWS = (
    Row("tr-1", (11, 242, 71, 3, 66, 11, 4, 2), (11, 242, 147, 3, 66, 31, 4, 2)),
    Row("tr-2", (26, 676, 190, 125, 3250, 178, 58, 2), (26, 676, 375, 125, 3250, 1317, 58, 2)),
    Row("tr-3", (14, 196, 54, 36, 504, 60, 11, 2), (14, 196, 133, 36, 504, 247, 11, 2)),
    Row("grip", (14, 196, 42, 20, 280, 80, 39, 4), (14, 196, 84, 20, 280, 120, 39, 4)),
    Row("gator", (49, 2401, 363, 215, 10535, 614, 278, 1), (49, 2401, 1481, 215, 10535, 4711, 278, 1)),
    Row("hand", (66, 4356, 516, 243, 16038, 171, 118, 2), (66, 4356, 1994, 243, 16038, 6270, 118, 2)),
)
MEMO_TABLE_1 = {row.name: row.distance_first for row in MEMO_ROWS}
MEMO_TABLE_2 = {row.name: row.angle_first for row in MEMO_ROWS}
MEMO_TABLE_3 = {
    "tr-1": (0.707, 0.392, 0.988, 0.833, 0.530, 0.939),
    "tr-2": (0.719, 0.445, 0.815, 0.945, 0.595, 0.982),
    "tr-3": (0.724, 0.321, 0.816, 0.881, 0.501, 0.978),
    "grip": (0.786, 0.571, 0.898, 0.714, 0.571, 0.861),
    "gator": (0.849, 0.383, 0.910, 0.941, 0.553, 0.974),
    "hand": (0.882, 0.542, 0.944, 0.989, 0.609, 0.993),
}
MEMO_TWELVE = (12, 144, 52, 34, 408, 23, 14, 2)

TWELVE = (
    (-40, -20), (-10, -24), (-6, -8), (10, -10), (12, -26), (38, -20),
    (42, 14), (16, 12), (12, 30), (-14, 26), (-18, 8), (-38, 12),
)  # fmt: skip


def efficiencies(distance_first: tuple[int, ...], angle_first: tuple[int, ...]) -> tuple[float, ...]:
    """Table III from Tables I and II: D2, A2, DA2, D3, A3, DA3, each the share that is pruned.

    DA2 is (I2 − I2A)/I2 and DA3 is (I3 − I3A)/I3. That gives the memo's figures, where its text is garbled.
    """
    two, after_distance_2, left_2, three, after_distance_3, left_3 = distance_first[1:7]
    after_angle_2, after_angle_3 = angle_first[2], angle_first[5]
    pruned = (
        (two, after_distance_2),
        (two, after_angle_2),
        (two, left_2),
        (three, after_distance_3),
        (three, after_angle_3),
        (three, left_3),
    )
    return tuple((whole - left) / whole for whole, left in pruned)


def seeded_grip(model: ObjectModel, seed: int) -> list[Contact]:
    """The object put down at random, and the first grip on it whose three fingers all touch."""
    rng = np.random.default_rng([705, seed])
    while True:
        placed = place(model, rng)
        contacts = grip(placed, rng, radius=0.0, bound=0.0, half_range=None, ring=FAR_MM, aim=0.0)
        if all(contact.touched for contact in contacts):
            return contacts


def counted(model: ObjectModel, grips: int) -> list[MemoCounts]:
    """Counts of that many seeded grips on one object."""
    catalogue = Catalogue([model])
    return [memo_counts(catalogue, seeded_grip(model, seed)) for seed in range(grips)]


def representative_row(model: ObjectModel, grips: int = GRIPS) -> Row:
    """The grip with the median number of interpretations that are left to the model test."""
    counts = sorted(counted(model, grips), key=lambda each: each.distance_first[6])
    chosen = counts[len(counts) // 2]
    return Row(model.name, chosen.distance_first, chosen.angle_first)


def difference(counts: tuple[int, ...], memo: tuple[int, ...]) -> float:
    """How far counts are from the memo's: the sum of the logarithms of their ratios."""
    return sum(abs(math.log(max(ours, 0.5) / theirs)) for ours, theirs in zip(counts, memo, strict=True))


def twelve_sided_row(searched: int = SEARCHED) -> Row:
    """The grip on the polygon with twelve edges that comes closest to the memo's counts."""
    counts = counted(flat("twelve", TWELVE), searched)
    chosen = min(counts, key=lambda each: difference(each.distance_first, MEMO_TWELVE))
    return Row("twelve", chosen.distance_first, chosen.angle_first)


def table(
    title: str, columns: tuple[str, ...], rows: list[tuple[str, tuple[float, ...], tuple[float, ...]]]
) -> str:
    """A table with two lines for each object, ours and the memo's."""
    lines = [title, f"  {'object':<8}{'':<9}" + "".join(f"{column:>8}" for column in columns)]
    for name, ours, memo in rows:
        lines.append(f"  {name:<8}{'palpate':<9}" + "".join(cell(value) for value in ours))
        lines.append(f"  {'':<8}{'memo':<9}" + "".join(cell(value) for value in memo))
    return "\n".join(lines)


def cell(value: float) -> str:
    """A count, or a share with three digits, in eight columns."""
    return f"{value:>8,}" if isinstance(value, int) else f"{value:>8.3f}"


def tables(rows: list[Row]) -> str:
    """All three tables for objects that the memo has too."""
    return "\n\n".join(
        [
            table(
                "Table I: interpretations left, distance pruning first",
                DISTANCE_FIRST,
                [(row.name, row.distance_first, MEMO_TABLE_1[row.name]) for row in rows],
            ),
            table(
                "Table II: interpretations left, angle pruning first",
                ANGLE_FIRST,
                [(row.name, row.angle_first, MEMO_TABLE_2[row.name]) for row in rows],
            ),
            table(
                "Table III: shares pruned",
                EFFICIENCIES,
                [
                    (row.name, efficiencies(row.distance_first, row.angle_first), MEMO_TABLE_3[row.name])
                    for row in rows
                ],
            ),
        ]
    )


def heading() -> str:
    """What the figures are and are not."""
    names = ", ".join(item["name"] for item in json.loads(SHIPPED_OBJECTS.read_text())["objects"])
    return (
        "Pruning statistics in the manner of MIT AI Memo 705, section 2.3.\n"
        "The memo gives no vertices. Ours are other shapes with the same names and edge counts, and other\n"
        "grips, so the figures differ: compare their size, not their digits.\n"
        f"Objects: {names}. Three point fingers, evenly spaced,\n"
        f"exact positions, no normals. Median grip of {GRIPS} by column 3A of Table I."
    )


def main() -> None:
    """Print everything."""
    print(heading(), flush=True)
    rows = [representative_row(model) for model in outlines(SHIPPED_OBJECTS)]
    print(f"\n{tables(rows)}\n", flush=True)
    twelve = twelve_sided_row()
    title = f"Twelve edges (memo Fig. 7), distance pruning first; nearest to the memo's of {SEARCHED} grips"
    print(table(title, DISTANCE_FIRST, [("twelve", twelve.distance_first, MEMO_TWELVE)]))


if __name__ == "__main__":
    main()
