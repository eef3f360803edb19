"""Table of predictions: the outcome of each approach under each hypothesis."""

from palpate.views.svg import element, shorten, text
from palpate.views.table_picture.frame import View
from palpate.views.table_picture.marks import badge, heading
from palpate.views.table_picture.style import INK, MOST_OTHERS, MUTED, RULE, THIN, Column
from palpate.views.table_picture.values import ApproachArrow, OtherHypothesis, Picture

__all__ = ["prediction_table", "prediction_width"]

_NAME, _OUTCOME = 136.0, 106.0
_ABREAST = 3  # approaches beside each other
_LINE = 14.5
_SIZE = 11.5
_HEADS = ("from x, y (mm)", "along", "at most (mm)", "stop (mm), normal")


def prediction_width(picture: Picture) -> float:
    """Width (SVG units) that the table needs; 0 without approaches."""
    if not picture.approaches:
        return 0.0
    return _NAME + _OUTCOME * min(len(picture.approaches), _ABREAST)


def prediction_table(picture: Picture, _view: View, column: Column, y: float) -> tuple[str, float]:
    """A row for each hypothesis that is drawn, a column for each approach; the y at which it ends."""
    if not picture.approaches:
        return "", y
    count = len(picture.others)
    title = f"Predictions of the hypotheses ({count})" if count > 1 else "Predictions of the hypothesis"
    shown = [heading(title, column, y + 12)]
    y += 22
    for first in range(0, len(picture.approaches), _ABREAST):
        part, y = _block(picture, picture.approaches[first : first + _ABREAST], column, y)
        shown.append(part)
    hidden = len(picture.others) - MOST_OTHERS
    if hidden > 0:
        y += _LINE + 2
        shown.append(text(f"and {hidden} more, not drawn", column.left + 26, y, size=12, fill=MUTED))
    return "".join(shown), y + 6


def _block(
    picture: Picture, approaches: tuple[ApproachArrow, ...], column: Column, y: float
) -> tuple[str, float]:
    at = [column.right - _OUTCOME * (len(approaches) - k) for k in range(len(approaches))]
    shown = [_lines((item.finger,), x, y, bold=True) for item, x in zip(approaches, at, strict=True)]
    shown.append(_lines(_HEADS, column.left, y + _LINE, room=_NAME))
    shown += [_lines(item.words, x, y + _LINE) for item, x in zip(approaches, at, strict=True)]
    y += _LINE * (1 + len(_HEADS)) + 5
    for index, other in enumerate(picture.others[:MOST_OTHERS]):
        shown.append(
            element("line", x1=column.left, y1=y, x2=column.right, y2=y, stroke=RULE, stroke_width=THIN / 2)
        )
        shown.append(_name(picture, index, other, column.left, at[0], y))
        outcomes = [item.predictions[index].words for item in approaches]
        shown += [_outcome(words, x, y) for words, x in zip(outcomes, at, strict=True)]
        y += _LINE * max(2, *(len(words) for words in outcomes)) + 6
    return "".join(shown), y


def _name(picture: Picture, index: int, other: OtherHypothesis, left: float, right: float, y: float) -> str:
    room = right - left - 34
    return (
        badge(index, picture.colour(index), left + 9, y + 17)
        + text(shorten(other.label, 12, room), left + 26, y + _LINE, size=12)
        + text(shorten(other.reason, 11, room), left + 26, y + 2 * _LINE, size=11, fill=MUTED)
    )


def _outcome(words: tuple[str, ...], left: float, y: float) -> str:
    return _lines(words[:1], left, y, colour=INK) + _lines(words[1:], left, y + _LINE)


def _lines(
    words: tuple[str, ...],
    left: float,
    y: float,
    *,
    colour: str = MUTED,
    bold: bool = False,
    room: float = _OUTCOME,
) -> str:
    return "".join(
        text(
            shorten(line, _SIZE, room - 6, bold=bold),
            left,
            y + _LINE * (k + 1),
            size=_SIZE,
            fill=INK if bold else colour,
            weight="bold" if bold else None,
        )
        for k, line in enumerate(words)
    )
