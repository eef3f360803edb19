"""Report of a catalogue on a rig: pairs that are not told apart, what would help, all states, pictures."""

from collections.abc import Iterator, Sequence
from importlib.metadata import version
from itertools import chain

from palpate.base.errors import counted
from palpate.config.objects_result import ObjectsCheckOut, SeparatingOut, StateListedOut, StateNameOut
from palpate.views.catalogue.check_text import fit_words, help_words, rig_words
from palpate.views.report.page import heading, lines, page, paragraph, picture, section, table

__all__ = ["catalogue_report"]

_SHOWN = 400  # pairs of a kind
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
        *chain.from_iterable(_pairs(found, kind) for kind in _KINDS),
        *_not_known(found),
        section("States", _states(states)),
        section("Sections", *map(picture, pages), kind="sections"),
        section("Rig", lines("\n".join(rig_words(found.rig)))),
        section("Versions", paragraph(f"palpate {version('palpate')}")),
    ]
    return page(f"{found.objects} on rig {found.rig.name}", parts)


def _title(found: ObjectsCheckOut, never: int) -> str:
    if never:
        return f"{counted(never, 'pair', 'pairs')} of states can never be distinguished"
    if found.pairs:
        return f"{counted(len(found.pairs), 'pair', 'pairs')} of states may not be distinguished"
    return "Every state is distinguished from every other"


def _pairs(found: ObjectsCheckOut, kind: str) -> Iterator[str]:
    pairs: list[SeparatingOut] = [pair for pair in found.pairs if pair.likeness == kind]
    if not pairs:
        return
    names = ("one", "other", "how alike", "what would help")
    rows = [
        (_name(pair.first), _name(pair.second), fit_words(pair), help_words(pair, found.rig))
        for pair in pairs[:_SHOWN]
    ]
    more = [paragraph(f"and {len(pairs) - _SHOWN} more")] if len(pairs) > _SHOWN else []
    yield section(_KINDS[kind], table(names, rows), *more)


def _not_known(found: ObjectsCheckOut) -> Iterator[str]:
    if found.not_known:
        rows = [
            (_name(item.state), ", ".join(f"{height:g} mm" for height in item.heights_mm))
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


def _name(item: StateNameOut) -> str:
    return f"{item.object}, {item.state}"
