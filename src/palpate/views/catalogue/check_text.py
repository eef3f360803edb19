"""What `palpate objects check` found, in words for a terminal of 80 columns."""

import math
from collections.abc import Iterator, Sequence

from palpate.base.errors import counted
from palpate.base.vocabulary import TipShape
from palpate.config.objects_result import ObjectsCheckOut, PairOut, RigHeightOut, RigHeightsOut, SeparatingOut

__all__ = ["check_lines", "fit_words", "help_words", "pair_lines", "rig_words"]

_SHOWN = 40  # pairs of a kind
_RANGES_SHOWN = 4
_NOTHING_MM = 0.005


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
        f"{counted(out.states, 'state', 'states')}, {counted(out.pairs_compared, 'pair', 'pairs')}:",
        f"  {out.told_apart:5d} distinguished",
        f"  {len(never):5d} never distinguished",
        f"  {len(maybe):5d} may or may not be distinguished",
    ]
    if unknown:
        lines.append(f"  {len(unknown):5d} not distinguished as far as their sections are known")
    most = None if every else _SHOWN
    for title, sign, pairs in (
        ("never distinguished", "=", never),
        ("may or may not be distinguished", "≈", maybe),
        ("not distinguished as far as known", "?", unknown),
    ):
        if pairs:
            lines += ["", title]
            lines += [line for pair in pairs[:most] for line in _separating_lines(pair, sign, out.rig)]
            lines += _more(pairs[most:])
    if out.not_known:
        lines += ["", "not known at the height of a finger; import them again for its height"]
        lines += [
            f"  {item.state.object}, {item.state.state}: {_heights(item.heights_mm)}"
            for item in out.not_known[:most]
        ]
        lines += _more(out.not_known[most:])
    return lines


def rig_words(rig: RigHeightsOut) -> list[str]:
    """Where the rig's fingers are."""
    shipped = ", the shipped one" if rig.shipped else ""
    heights = [
        f"  at {item.height_mm:g} mm: {', '.join(item.fingers)}, {_tip_words(item)}" for item in rig.heights
    ]
    off = f"  contacts may be off by up to {rig.contact_bound_mm:.2f} mm about the middle of the table"
    return [f"fingers of rig {rig.name}{shipped}", *heights, off]


def _tip_words(item: RigHeightOut) -> str:
    if item.tip_shape is TipShape.PAD:
        pads = "a pad" if len(item.fingers) == 1 else "pads"
        return f"{pads} {2 * item.tip_radius_mm:g} mm wide, here taken for discs of that width"
    kind = "ball" if item.tip_shape is TipShape.BALL else "tip"
    return f"{kind if len(item.fingers) == 1 else f'{kind}s'} of radius {item.tip_radius_mm:g} mm"


def fit_words(*pairs: PairOut) -> str:
    """How well two agree at the fingers' heights; or each two of several pairs that are alike in all else."""
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
    if max(found) < _NOTHING_MM:
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
    yield f"      {help_words(pair, rig)}"
    if pair.tried < pair.ranges:
        yield f"      ({pair.tried} of {pair.ranges} ranges of height were looked at)"


def help_words(pair: SeparatingOut, rig: RigHeightsOut) -> str:
    """At which heights one more finger of the rig's kind would distinguish the two."""
    balls = [item.tip_shape is TipShape.BALL for item in rig.heights]
    another = "a ball" if all(balls) else "an upright tip" if any(balls) else "a finger"
    if pair.separating_mm:
        shown = [_inside(found) for found in pair.separating_mm[:_RANGES_SHOWN]]
        more = len(pair.separating_mm) - len(shown)
        kind = "height" if all(balls) else "range"
        rest = f" and {counted(more, f'more {kind}', f'more {kind}s')}" if more else ""
        at = " or ".join(filter(None, (", ".join(shown[:-1]), shown[-1])))
        return f"{another} at {at} mm{rest} would distinguish them"
    if all(balls):
        return "no height that was tried would distinguish them for certain"
    if not pair.known:
        return "no one height at which both are known would distinguish them"
    return "no one height would distinguish them for certain"


def _inside(range_mm: tuple[float, float]) -> str:
    """A range to hundredths of a mm, rounded inward: all of what is said holds."""
    if range_mm[0] == range_mm[1]:
        return f"{range_mm[0]:g}"
    low, high = math.ceil(100 * range_mm[0] - 1e-3) / 100, math.floor(100 * range_mm[1] + 1e-3) / 100
    return f"{low:g}–{high:g}" if low < high else f"{range_mm[0]:.6g}–{range_mm[1]:.6g}"


def _heights(heights_mm: Sequence[float]) -> str:
    words = [f"{height:g}" for height in heights_mm]
    return (
        f"{words[0] if len(words) == 1 else ', '.join(words[:-1]) + ' and ' + words[-1]} mm" if words else ""
    )


def _more(left: Sequence[object]) -> list[str]:
    return [f"  and {len(left)} more; --all lists them"] if left else []
