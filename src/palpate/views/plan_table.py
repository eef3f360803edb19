"""A plan on the terminal: the approaches, and the predictions of each hypothesis."""

import math
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from palpate.base.errors import quantity
from palpate.recognizer import Grip, Hypothesis, Prediction
from palpate.rig.identification.grip_choice import GripPlan
from palpate.views.numerals import decimal
from palpate.views.plan import (
    MAX_LETTERS,
    certainty,
    direction_text,
    hypotheses_words,
    letter,
    may_miss,
    normal_words,
    remaining_confusion,
    stop_words,
)
from palpate.views.tables import folding_column, table

_NAME_COLUMNS = 22  # columns for a hypothesis
_LEAD_COLUMNS = _NAME_COLUMNS + 5  # and its letter, with the gaps between
_LONG_OUTCOME_COLUMNS, _SHORT_OUTCOME_COLUMNS = (
    50,
    18,
)  # columns for an outcome that names what it gives, or that leaves it to the heading
_MAX_OUTCOME_SETS = 6


def print_plan(planned: GripPlan, console: Console) -> None:
    """Print the plan; its recognition has at least one hypothesis."""
    recognition, grip = planned.recognition, planned.grip
    count = len(recognition.hypotheses)
    touched = sum(contact.touched for contact in recognition.contacts)
    console.print(
        f"{recognition.verdict.value}: {quantity(count, 'hypothesis', 'hypotheses')} after "
        f"{quantity(touched, 'contact', 'contacts')} and "
        f"{quantity(len(recognition.contacts) - touched, 'miss', 'misses')}"
    )
    if grip is None:
        console.print()
        console.print(_outcomes(planned, None, (), 0))
    else:
        console.print(f"next grip ({planned.strategy.value}), about {grip.seconds:.0f} s:\n")
        console.print(_approaches(planned, grip))
        for block in _blocks(planned.rows, console.width):
            console.print()
            console.print(_outcomes(planned, grip, block, console.width))
    if count > MAX_LETTERS:
        console.print(f"and {count - MAX_LETTERS} more hypotheses; the JSON lists them all", style="dim")
    console.print()
    for line in certainty(planned):
        console.print(line)
    share = remaining_confusion(planned)
    if share is not None:
        console.print(f"expected remaining confusion: {share}")
    for group in planned.alike[:_MAX_OUTCOME_SETS]:
        console.print(f"indistinguishable within reach: {hypotheses_words(group)}")
    if len(planned.alike) > _MAX_OUTCOME_SETS:
        console.print(f"and {len(planned.alike) - _MAX_OUTCOME_SETS} more such sets")


def _approaches(planned: GripPlan, grip: Grip) -> Table:
    numbers = "from x, y", "direction", "at most"
    lines = table("finger", *numbers, numbers=numbers)
    for row in planned.rows:
        candidate, travel = grip.approaches[row], grip.travels_mm[row]
        x, y = (decimal(value, 1) for value in candidate.start_mm)
        lines.add_row(
            Text(planned.finger_name(candidate), style="bold"),
            f"{x}, {y} mm",
            direction_text(candidate.direction_rad),
            f"{travel:.1f} mm",
        )
    return lines


def _outcomes(planned: GripPlan, grip: Grip | None, rows: Sequence[int], width: int) -> Table:
    """A row for each hypothesis shown, a column for each of some fingers."""
    lines = table("", folding_column("hypothesis", _NAME_COLUMNS))
    long = _LEAD_COLUMNS + _LONG_OUTCOME_COLUMNS * len(rows) <= width
    for row in rows:
        assert grip is not None, "no approaches without a grip"
        name = planned.finger_name(grip.approaches[row])
        lines.add_column(name if long else f"{name} stops at\nwith normal", no_wrap=True)
    for index, item in enumerate(planned.recognition.hypotheses[:MAX_LETTERS]):
        outcomes = [] if grip is None else [grip.predictions.of(row, index) for row in rows]
        cells = [_long_outcome(outcome) if long else _short_outcome(outcome) for outcome in outcomes]
        lines.add_row(Text(letter(index), style="bold"), _hypothesis(item), *cells)
    return lines


def _hypothesis(item: Hypothesis) -> Text:
    name = f"{item.state.object_name}, {item.state.state.name}"
    share = f"{100 * item.weight:.0f} %"
    at = item.configuration
    place = f"{decimal(at.x_mm, 1)}, {decimal(at.y_mm, 1)} mm, {decimal(math.degrees(at.theta_rad), 0)}°"
    if len(name) > _NAME_COLUMNS - 6:
        name = f"{name}\n"
    return Text.assemble(f"{name:<{_NAME_COLUMNS - 6}}{share:>6}", "\n", (place, "dim"))


def _long_outcome(item: Prediction) -> str:
    """An outcome in one line."""
    stop, normal = stop_words(item), normal_words(item)
    if stop is None:
        return "misses"
    return f"stops at {stop} mm{' or misses' * may_miss(item)}\nwith normal {normal}"


def _short_outcome(item: Prediction) -> str:
    """An outcome in lines no longer than a column is wide."""
    stop, normal = stop_words(item), normal_words(item)
    if stop is None:
        return "misses"
    return f"{stop} mm\n{normal}" + "\nor misses" * may_miss(item)


def _blocks(rows: Sequence[int], width: int) -> list[Sequence[int]]:
    """Approaches whose columns fit beside each other."""
    size = max(1, (width - _LEAD_COLUMNS + 2) // _SHORT_OUTCOME_COLUMNS)
    return [rows[first : first + size] for first in range(0, len(rows), size)]
