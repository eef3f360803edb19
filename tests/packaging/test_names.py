"""Names and English of the package: one word for one thing, and sentences that say what a thing is."""

import ast
import re
from collections import Counter, defaultdict

from support.commands.repository import PACKAGE

TREES = {path.relative_to(PACKAGE): ast.parse(path.read_text("utf-8")) for path in PACKAGE.rglob("*.py")}

TWICE = {"Serial"}
"""pyserial looks for a class of this name in the module of each URL handler."""

ELLIPTICAL = re.compile(
    r"(Of|As|Where|What|How|Those|By|For|From|That|Which|With|In|On|Such|To|Beside|Up|At|It|They|Its|Their"
    r"|Also|Nothing|Something|Some|None|Whether|When|Who|Likewise)\b(?!-)"
)
MOST_ELLIPTICAL = 0.01
"""Share of docstrings that may begin so: now and then such a word begins a good sentence."""

PARTICIPLE = re.compile(
    r"_*(?!(?:speed|seed|feed|need|embed|bed|shed)(?:_|$))([a-z]+ed|felt|told|found|taken|made|held|kept|known"
    r"|drawn|seen|said|shown|given|sent|worn|met|torn|written|built|bent|begun|bound|bought|brought|caught|chosen"
    r"|done|driven|fallen|flown|forgotten|frozen|got|gone|grown|heard|hidden|hurt|laid|led|lent|lost|meant|paid"
    r"|proven|sold|spent|spoken|stolen|stood|struck|swept|swung|taught|thrown|understood|wound|won)(?:_|$)"
)
MOST_PARTICIPLES = 0.04
"""Share of functions that may be named so."""

SAYING_NOTHING = {"FEW", "MANY", "SHOWN", "AS_FAR", "MOST", "MOST_HALVES", "SOME", "ENOUGH", "MORE", "LESS"}


def test_a_public_class_name_stands_for_one_thing() -> None:
    places = defaultdict(list)
    for path, tree in TREES.items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(str(path))
    assert {name: found for name, found in places.items() if len(found) > 1 and name not in TWICE} == {}


def test_docstrings_begin_with_a_noun_or_a_verb() -> None:
    docs = [
        ast.get_docstring(node)
        for tree in TREES.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
    ]
    found = Counter(match[1] for doc in docs if doc and (match := ELLIPTICAL.match(doc)))
    assert found.total() <= MOST_ELLIPTICAL * sum(map(bool, docs)), found


def test_functions_are_named_by_verbs_and_nouns() -> None:
    names = [
        (path, node.name)
        for path, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and "property" not in map(ast.unparse, node.decorator_list)
    ]
    bad = [f"{path}: {name}" for path, name in names if PARTICIPLE.match(name)]
    assert len(bad) <= MOST_PARTICIPLES * len(names), "\n".join(sorted(bad))


def test_constants_say_what_they_limit() -> None:
    bad = [
        f"{path}: {target.id}"
        for path, tree in TREES.items()
        for node in tree.body
        for target in (*getattr(node, "targets", ()), getattr(node, "target", None))
        if isinstance(target, ast.Name) and target.id.lstrip("_") in SAYING_NOTHING
    ]
    assert bad == []
