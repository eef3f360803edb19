"""Groups of pairs of twins: six states that are all alike make fifteen pairs and one group.

States are grouped that stand to each other as they stand to all the rest: a group is alike within itself, and
two groups are alike throughout, or not at all.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from palpate.config.objects_result import PairOut, StateNameOut

__all__ = ["TwinGroup", "group_pairs"]

_Name = tuple[str, str]
_Relation = tuple[object, ...]


@dataclass(frozen=True)
class TwinGroup:
    """Every state of `first` with every one of `second`; if that is empty, all of `first` with each other.

    `pairs`: all of them, at least one. They are alike in everything but `apart_mm`.
    """

    first: tuple[StateNameOut, ...]
    second: tuple[StateNameOut, ...]
    pairs: tuple[PairOut, ...]


def group_pairs(pairs: Sequence[PairOut]) -> tuple[TwinGroup, ...]:
    """The pairs in groups, ordered by the first pair of each."""
    names = {_key(item): item for pair in pairs for item in (pair.first, pair.second)}
    relations: dict[_Name, dict[_Name, _Relation]] = {name: {} for name in names}
    for pair in pairs:
        one, other = _key(pair.first), _key(pair.second)
        relations[one][other] = relations[other][one] = _relation(pair)
    groups = _groups(relations)
    group_of = {name: number for number, group in enumerate(groups) for name in group}
    together: dict[tuple[int, int], list[PairOut]] = {}
    for pair in pairs:
        first, second = group_of[_key(pair.first)], group_of[_key(pair.second)]
        together.setdefault((min(first, second), max(first, second)), []).append(pair)
    members = [tuple(names[name] for name in group) for group in groups]
    return tuple(
        TwinGroup(members[one], () if one == other else members[other], tuple(found))
        for (one, other), found in together.items()
    )


def _groups(relations: dict[_Name, dict[_Name, _Relation]]) -> list[list[_Name]]:
    """The states in groups. Standing alike to all others is transitive: one of a group stands for it."""
    groups: list[list[_Name]] = []
    for name, own in relations.items():
        for group in groups:
            if _stand_alike(name, own, group[0], relations[group[0]]):
                group.append(name)
                break
        else:
            groups.append([name])
    return groups


def _stand_alike(
    one: _Name, to_one: dict[_Name, _Relation], other: _Name, to_other: dict[_Name, _Relation]
) -> bool:
    if len(to_one) != len(to_other):
        return False
    return all(to_other.get(name) == how for name, how in _without(to_one, other)) and all(
        to_one.get(name) == how for name, how in _without(to_other, one)
    )


def _without(relations: dict[_Name, _Relation], name: _Name) -> Iterator[tuple[_Name, _Relation]]:
    return ((other, how) for other, how in relations.items() if other != name)


def _key(state: StateNameOut) -> _Name:
    return state.object, state.state


def _relation(pair: PairOut) -> _Relation:
    """All that is said of a pair but its distance."""
    return pair.likeness, pair.compared_mm, pair.apart_mm is None, pair.tolerance_mm, pair.within_mm
