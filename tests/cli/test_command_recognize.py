"""`palpate recognize`: spurious contacts, objects that moved, and why an object was ruled out."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palpate.config.loading import shipped_objects
from palpate.config.schema import schema_text
from palpate.recognizer import Contact
from palpate.rig.conversion import contacts_json
from support.commands.command import Ended, Here, violations
from support.oracles.shapely_touches import SHIPPED_OBJECTS, Placed, grip, outlines, place


@pytest.fixture
def ask(tmp_path: Path, here: Here) -> Here:
    """Run the command on grips, with the shipped objects."""

    def asked(grips: Sequence[Sequence[Contact]], *options: object) -> Ended:
        file = tmp_path / "felt.json"
        file.write_text(json.dumps(contacts_json(grips)))
        args = ["recognize", "--objects", shipped_objects(), "--contacts", file, *options]
        return here(*args)

    return asked


def touching(placed: Placed, rng: np.random.Generator, fingers: int) -> list[Contact]:
    """A grip of which every finger touches."""
    while True:
        contacts = grip(placed, rng, fingers=fingers)
        if all(contact.touched for contact in contacts):
            return contacts


def one_bad_contact() -> list[Contact]:
    """A grip on tr-2 of five fingers; f2 was stopped by something else on its way."""
    rng = np.random.default_rng(7)
    contacts = touching(place(outlines(SHIPPED_OBJECTS)[1], rng), rng, 5)
    x, y = contacts[1].start_mm
    return [contacts[0], replace(contacts[1], end_mm=(0.8 * x, 0.8 * y)), *contacts[2:]]


def schema() -> object:
    return json.loads(schema_text("recognition"))


def test_a_spurious_contact(ask: Here) -> None:
    grips = [one_bad_contact()]
    ended = ask(grips)
    assert ended.code == 1
    assert ended.out.startswith("none: 0 hypotheses after 5 contacts")
    assert "nothing in the catalogue fits all contacts\n" in ended.out
    assert "without contact f2 something fits: it may be spurious (allow 1 spurious)\n" in ended.out

    told = ask(grips, "--json").json
    assert violations(told, schema()) == []
    assert told["explanation"] == {
        "moved_after_grip": None,
        "spurious": [{"grip": 0, "finger": "f2", "touched": True}],
    }
    assert told["why"] is None

    ended = ask(grips, "--max-spurious", 1)
    assert ended.code == 0
    assert "tr-2, flat" in ended.out
    assert "without f2" in ended.out
    told = ask(grips, "--max-spurious", 1, "--json").json
    assert violations(told, schema()) == []
    (hypothesis,) = told["hypotheses"]
    assert hypothesis["object"] == "tr-2"
    assert hypothesis["spurious"] == ["f2"]
    for interpretation in hypothesis["interpretations"]:
        assert [edge is None for edge in interpretation["edges"]] == [False, True, False, False, False]
        assert [name is None for name in interpretation["features"]] == [False, True, False, False, False]
    assert told["explanation"] is None


def test_nothing_is_spurious(ask: Here) -> None:
    rng = np.random.default_rng(8)
    told = ask([touching(place(outlines(SHIPPED_OBJECTS)[5], rng), rng, 4)], "--json").json
    assert [item["spurious"] for item in told["hypotheses"]] == [[]] * len(told["hypotheses"])


def test_too_many_spurious_contacts(ask: Here) -> None:
    for number, said in ((5, "from 0 to 4"), (-1, "--max-spurious")):
        ended = ask([one_bad_contact()], "--max-spurious", number)
        assert ended.code == 2
        assert said in ended.err


def test_an_object_that_moved(ask: Here) -> None:
    rng = np.random.default_rng(9)
    placed = place(outlines(SHIPPED_OBJECTS)[3], rng)
    pushed = replace(placed, x=placed.x + 11.0, theta=placed.theta - 0.35)
    grips = [touching(where, rng, 4) for where in (placed, placed, pushed)]
    ended = ask(grips)
    assert ended.code == 1
    assert "each grip alone fits: the object may have moved after grip 2\n" in ended.out
    assert "spurious" not in ended.out
    told = ask(grips, "--json").json
    assert violations(told, schema()) == []
    assert told["explanation"] == {"moved_after_grip": 2, "spurious": []}


def test_why_not(ask: Here) -> None:
    rng = np.random.default_rng(10)
    contacts = touching(place(outlines(SHIPPED_OBJECTS)[1], rng), rng, 4)
    ended = ask([contacts], "--why", "hand")
    assert ended.code == 0
    head = ended.out.index("hand: ruled out by ")
    table = ended.out[head:].splitlines()
    assert table[1].split()[-2:] == ["interpretations", "left"]
    assert table[-2].endswith(" 0")
    assert table[-1].endswith(" be true of it")

    told = ask([contacts], "--why", "hand/flat", "--json").json
    assert violations(told, schema()) == []
    because = told["why"]
    assert (because["object"], because["state"], because["ruled_out"]) == ("hand", "flat", True)
    assert because["steps"][0]["reason"] == "edges"
    assert [step["left"] > 0 for step in because["steps"]] == [True] * (len(because["steps"]) - 1) + [False]
    assert because["conflict"]
    assert because["hypotheses"] == []


def test_why_of_the_object_that_is_there(ask: Here) -> None:
    rng = np.random.default_rng(10)
    contacts = touching(place(outlines(SHIPPED_OBJECTS)[1], rng), rng, 4)
    ended = ask([contacts], "--why", "tr-2")
    assert "tr-2: not ruled out\n" in ended.out
    because = ask([contacts], "--why", "tr-2", "--json").json["why"]
    assert (because["state"], because["ruled_out"], because["conflict"]) == (None, False, [])
    assert {item["object"] for item in because["hypotheses"]} == {"tr-2"}


def test_why_names_grips_and_misses(ask: Here) -> None:
    """A miss right through the part cannot be true together with what was touched."""
    rng = np.random.default_rng(11)
    placed = place(outlines(SHIPPED_OBJECTS)[1], rng)
    contacts = touching(placed, rng, 4)
    height = placed.shape.centroid.y
    through = replace(
        contacts[0], touched=False, normal=None, start_mm=(-150.0, height), end_mm=(150.0, height)
    )
    ended = ask([contacts, [through]], "--why", "tr-2")
    assert ended.code == 1
    assert "tr-2: ruled out by the miss of f1 of grip 2\n" in ended.out
    assert "and the miss of f1 of grip 2 cannot" in ended.out


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("tr2", 'did you mean "tr-2"?'),
        ("hand/flta", 'did you mean "hand/flat"?'),
        ("xyzzy", "there are: tr-1, tr-2, tr-3, grip, gator, hand"),
    ],
)
def test_why_of_something_unknown(ask: Here, name: str, said: str) -> None:
    ended = ask([one_bad_contact()], "--why", name, "--json")
    assert ended.code == 2
    assert ended.out == ""
    assert ended.err.count("\n") == 1
    assert said in ended.err


def test_statistics_are_the_memos_tables(ask: Here) -> None:
    rng = np.random.default_rng(12)
    contacts = touching(place(outlines(SHIPPED_OBJECTS)[2], rng), rng, 3)
    memo = ask([contacts], "--statistics", "--json").json["statistics"]["memo"]
    first, last = memo["distance_first"], memo["angle_first"]
    assert len(first) == len(last) == 8
    # What passes both tests, its children and what passes the model test are the same in either order.
    assert [first[k] for k in (0, 1, 3, 4, 6, 7)] == [last[k] for k in (0, 1, 3, 4, 6, 7)]
    assert first[1] >= first[2] >= first[3] >= 1
    assert first[7] >= 1
    said = ask([contacts], "--statistics").out
    assert "distance first" in said
    assert f"{first[1]:,}" in said
    assert ask([contacts], "--json").json["statistics"]["memo"] is None
