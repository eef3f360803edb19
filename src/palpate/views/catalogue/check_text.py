"""Result of `palpate objects check`: in words for a terminal of 80 columns, and as a page."""

from collections.abc import Iterator, Sequence
from importlib.metadata import version
from itertools import chain

from palpate.base.errors import join_words, quantity
from palpate.config.catalogue_results import (
    ObjectsCheckOut,
    PairOut,
    RigHeightOut,
    RigHeightsOut,
    SeparatingOut,
    StateListedOut,
    StateNameOut,
)
from palpate.rig.catalogue.section_stack import Range
from palpate.views.numerals import ceil_to, floor_to
from palpate.views.report.page import heading, lines, page, paragraph, picture, section, table

_MAX_PAIRS_PER_KIND = 40  # pairs of a kind
_MAX_RANGES = 4
_NEGLIGIBLE_MM = 0.005


def check_lines(out: ObjectsCheckOut, *, every: bool = False) -> list[str]:
    """Counts first, then pairs of each kind, then what is not known. `every`: however many there are."""
    never, maybe, unknown = (
        [pair for pair in out.pairs if pair.likeness == kind] for kind in ("same", "doubtful", "unknown")
    )
    if not out.pairs_compared:
        return [*rig_words(out.rig), "", "1 state: there is no other to tell it from"]
    lines = [
        *rig_words(out.rig),
        "",
        f"{quantity(out.states, 'state', 'states')}, {quantity(out.pairs_compared, 'pair', 'pairs')}:",
        f"  {out.told_apart:5d} distinguished",
        f"  {len(never):5d} never distinguished",
        f"  {len(maybe):5d} may or may not be distinguished",
    ]
    if unknown:
        lines.append(f"  {len(unknown):5d} not distinguished as far as their sections are known")
    most = None if every else _MAX_PAIRS_PER_KIND
    for title, sign, pairs in (
        ("never distinguished", "=", never),
        ("may or may not be distinguished", "≈", maybe),
        ("not distinguished as far as known", "?", unknown),
    ):
        if pairs:
            lines += ["", title]
            lines += [line for pair in pairs[:most] for line in _separating_lines(pair, sign, out.rig)]
            lines += _more_line(pairs[most:])
    if out.not_known:
        lines += ["", "not known at the height of a finger; import them again for its height"]
        lines += [
            f"  {item.state.object}, {item.state.state}: {_heights(item.heights_mm)}"
            for item in out.not_known[:most]
        ]
        lines += _more_line(out.not_known[most:])
    return lines


def rig_words(rig: RigHeightsOut) -> list[str]:
    """Say where the rig's fingers are."""
    shipped = ", the shipped one" if rig.shipped else ""
    heights = [
        f"  at {item.height_mm:g} mm: {', '.join(item.fingers)}, {_tip_words(item)}" for item in rig.heights
    ]
    off = f"  contacts may be off by up to {rig.contact_bound_mm:.2f} mm about the middle of the table"
    return [f"fingers of rig {rig.name}{shipped}", *heights, off]


def _tip_words(item: RigHeightOut) -> str:
    tip = item.tip_shape.tip
    taken = ", here taken for discs of that width" if tip.has_face else ""
    return f"{tip.noun}{'s'[: len(item.fingers) > 1]} {tip.size_text(item.tip_radius_mm)}{taken}"


def fit_words(*pairs: PairOut) -> str:
    """Say how well two agree at the fingers' heights, or each two of pairs that are alike in all else."""
    pair = pairs[0]
    at = _heights(pair.compared_mm)
    if not pair.compared_mm:
        return "at no finger's height are both known"
    found = [item.apart_mm for item in pairs if item.apart_mm is not None]
    if not found:
        return f"at {at} there is nothing of either: no finger touches them"
    least, most = f"{min(found):.2f}", f"{max(found):.2f}"
    apart = f"{least if least == most else f'{least}–{most}'} mm apart at {at}"
    if pair.likeness == "doubtful":
        return f"{apart}; {pair.within_mm:.2f} mm are certain to be distinguished"
    if max(found) < _NEGLIGIBLE_MM:
        return f"the same at {at}"
    allowed = f", within their tolerances ({pair.tolerance_mm:.2f} mm)" if pair.tolerance_mm else ""
    return f"{apart}{allowed}"


def pair_lines(pair: PairOut, sign: str) -> Iterator[str]:
    """Both states by name, and how near they are."""
    first, second = (f"{item.object}, {item.state}" for item in (pair.first, pair.second))
    if len(first) + len(second) <= 72:
        yield f"  {first}  {sign}  {second}"
    else:
        yield f"  {first}"
        yield f"  {sign} {second}"
    yield f"      {fit_words(pair)}"


def _separating_lines(pair: SeparatingOut, sign: str, rig: RigHeightsOut) -> Iterator[str]:
    yield from pair_lines(pair, sign)
    yield f"      {_help_words(pair, rig)}"
    if pair.tried < pair.ranges:
        yield f"      ({pair.tried} of {pair.ranges} ranges of height were looked at)"


def _help_words(pair: SeparatingOut, rig: RigHeightsOut) -> str:
    """Say at which heights one more finger of the rig's kind would distinguish the two."""
    tips = [item.tip_shape.tip for item in rig.heights]
    upright = [tip.is_upright for tip in tips]
    another = "a finger" if all(upright) else "an upright tip" if any(upright) else tips[0].with_article
    if pair.separating_mm:
        shown = [_inside_words(found) for found in pair.separating_mm[:_MAX_RANGES]]
        more = len(pair.separating_mm) - len(shown)
        kind = "range" if any(upright) else "height"
        rest = f" and {quantity(more, f'more {kind}', f'more {kind}s')}" if more else ""
        at = " or ".join(filter(None, (", ".join(shown[:-1]), shown[-1])))
        return f"{another} at {at} mm{rest} would distinguish them"
    if not any(upright):
        return "no height that was tried would distinguish them for certain"
    if not pair.known:
        return "no one height at which both are known would distinguish them"
    return "no one height would distinguish them for certain"


def _inside_words(range_mm: Range) -> str:
    """A range to hundredths of a mm, rounded inward: all of what is said holds."""
    if range_mm[0] == range_mm[1]:
        return f"{range_mm[0]:g}"
    low, high = _round_inward(range_mm)
    return f"{low:.6g}–{high:.6g}"


def known_words(known_mm: Sequence[Range], top_mm: float, most: int) -> str:
    """Say "known at 4.5–5.5 mm only", or "not known at 17.33–17.36 mm" where little is unknown.

    `known_mm`: ascending ranges, both ends included; `top_mm`: how high the part is. Ends are rounded to
    0.01 mm so that no more is called known than is. `most`: how many ranges are listed.
    """
    ends = [0.0, *(z for found in known_mm for z in found), top_mm]
    gaps = [(low, high) for low, high in zip(ends[::2], ends[1::2], strict=True) if low < high]
    if gaps and sum(high - low for low, high in gaps) < top_mm / 2:
        return f"not known at {_ranges_words([(floor_to(low), ceil_to(high)) for low, high in gaps], most)}"
    return f"known at {_ranges_words(list(map(_round_inward, known_mm)), most)} only"


def _round_inward(range_mm: Range) -> Range:
    """A range to hundredths of a mm; as it is where nothing would be left."""
    low, high = ceil_to(range_mm[0]), floor_to(range_mm[1])
    return (low, high) if low < high else range_mm


def _ranges_words(ranges_mm: Sequence[Range], most: int) -> str:
    words = [f"{low:.6g}–{high:.6g}" for low, high in ranges_mm[:most]]
    more = len(ranges_mm) - len(words)
    if not words:
        return quantity(more, "range of height", "ranges of height")
    if more:
        return f"{', '.join(words)} mm and {quantity(more, 'more range', 'more ranges')}"
    return f"{join_words(words)} mm"


def _heights(heights_mm: Sequence[float]) -> str:
    return f"{join_words([f'{height:g}' for height in heights_mm])} mm" if heights_mm else ""


def _more_line(left: Sequence[object]) -> list[str]:
    return [f"  and {len(left)} more; --all lists them"] if left else []


_MAX_PAIRS_ON_PAGE = 400  # pairs of a kind
_KINDS = {
    "same": "Never distinguished",
    "doubtful": "May or may not be distinguished",
    "unknown": "Not distinguished as far as their sections are known",
}


def catalogue_report(
    found: ObjectsCheckOut, states: Sequence[StateListedOut], pages: Sequence[str], notices: Sequence[str]
) -> str:
    """The page. `pages`: pictures (SVG) of all sections; `notices`: what fingers cannot reach."""
    counts = {kind: sum(pair.likeness == kind for pair in found.pairs) for kind in _KINDS}
    parts = [
        heading(_title(found, counts["same"]), f"catalogue {found.objects}, rig {found.rig.name}"),
        section(
            "Result",
            table(
                ("", ""),
                [
                    ("states", str(found.states)),
                    ("pairs compared", str(found.pairs_compared)),
                    ("distinguished for certain", str(found.told_apart)),
                    *((words.lower(), str(counts[kind])) for kind, words in _KINDS.items() if counts[kind]),
                ],
            ),
            *map(paragraph, notices),
        ),
        *chain.from_iterable(_pairs_section(found, kind) for kind in _KINDS),
        *_not_known(found),
        section("States", _states(states)),
        section("Sections", *map(picture, pages), kind="sections"),
        section("Rig", lines("\n".join(rig_words(found.rig)))),
        section("Versions", paragraph(f"palpate {version('palpate')}")),
    ]
    return page(f"{found.objects} on rig {found.rig.name}", parts)


def _title(found: ObjectsCheckOut, never: int) -> str:
    if never:
        return f"{quantity(never, 'pair', 'pairs')} of states can never be distinguished"
    if found.pairs:
        return f"{quantity(len(found.pairs), 'pair', 'pairs')} of states may not be distinguished"
    return "Every state is distinguished from every other"


def _pairs_section(found: ObjectsCheckOut, kind: str) -> Iterator[str]:
    pairs: list[SeparatingOut] = [pair for pair in found.pairs if pair.likeness == kind]
    if not pairs:
        return
    names = ("one", "other", "how alike", "what would help")
    rows = [
        (_state_name(pair.first), _state_name(pair.second), fit_words(pair), _help_words(pair, found.rig))
        for pair in pairs[:_MAX_PAIRS_ON_PAGE]
    ]
    more = (
        [paragraph(f"and {len(pairs) - _MAX_PAIRS_ON_PAGE} more")] if len(pairs) > _MAX_PAIRS_ON_PAGE else []
    )
    yield section(_KINDS[kind], table(names, rows), *more)


def _not_known(found: ObjectsCheckOut) -> Iterator[str]:
    if found.not_known:
        rows = [
            (_state_name(item.state), ", ".join(f"{height:g} mm" for height in item.heights_mm))
            for item in found.not_known
        ]
        yield section(
            "Not known at the height of a finger",
            paragraph("Import these again for the fingers' heights."),
            table(("state", "heights"), rows),
        )


def _states(states: Sequence[StateListedOut]) -> str:
    names = (
        "object",
        "state",
        "probability",
        "height, mm",
        "± mm",
        "symmetry",
        "fingers that meet it",
        "when pushed",
    )
    rows = [
        (
            item.object,
            item.state,
            "" if item.probability is None else f"{100 * item.probability:.1f} %",
            f"{item.top_mm:g}",
            f"{item.tolerance_mm:g}",
            "any turn" if item.symmetry_order == 0 else str(item.symmetry_order),
            item.fingers,
            item.when_pushed.value + (f": {item.why}" if item.why else ""),
        )
        for item in states
    ]
    return table(names, rows, numbers=names[2:6])


def _state_name(item: StateNameOut) -> str:
    return f"{item.object}, {item.state}"
