"""`palpate plan`: what it foretells agrees with brute force, who it cannot tell apart, and how it ends."""

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.config import load_rig, shipped_rig
from palpate.config.schema import schema_text
from palpate.recognizer import Approach, Catalogue, Contact, Finger
from palpate.rig.conversion import contacts_json
from palpate.rig.identification.grip_choice import indistinguishable_sets
from palpate.rig.reach.approaches import reach_of
from support.campaign.sampling import sample
from support.commands.command import Ended, Here, violations
from support.commands.repository import EXAMPLES
from support.oracles.plans import felt_along
from support.oracles.shapely_touches import (
    SHIPPED_OBJECTS,
    Placed,
    equivalent_configurations,
    outlines,
    outward_normal,
    place,
    stop,
    unit,
)

Planned = Mapping[str, Any]

RIG = load_rig(shipped_rig())
MODELS = {model.name: model for model in outlines(SHIPPED_OBJECTS)}
STRATEGIES = ("planned", "random", "rotate")


@pytest.fixture
def ask(tmp_path: Path, here: Here) -> Here:
    """Run the command on grips."""

    def asked(grips: Sequence[Sequence[Contact]], *options: object) -> Ended:
        file = tmp_path / "felt.json"
        file.write_text(json.dumps(contacts_json(grips)))
        return here("plan", "--contacts", file, *options)

    return asked


def carried_out(approaches: Sequence[Planned], placed: Placed, rng: np.random.Generator) -> list[Contact]:
    """What fingers of the shipped rig feel, off by no more than each approach allows."""
    return [_touch(item, placed, rng) for item in approaches]


def _touch(item: Planned, placed: Placed, rng: np.random.Generator) -> Contact:
    (spec,) = [finger for finger in RIG.fingers if finger.name == item["finger"]]
    finger = Finger(spec.tip.radius_mm, spec.height_mm)
    start, bound = tuple(item["start"]), item["position_bound"]
    return _felt(Approach(finger, start, item["direction"], item["travel"], bound), spec.name, placed, rng)


def _felt(approach: Approach, name: str, placed: Placed, rng: np.random.Generator) -> Contact:
    bound = approach.position_bound_mm
    return felt_along(
        approach, name, placed, rng, bound=0.6 * bound, path_bound=bound, half_range=math.radians(8)
    )


def first_grip(placed: Placed, rng: np.random.Generator, fingers: int = 3) -> list[Contact]:
    """Fingers go straight to the table's middle."""
    reach = reach_of(RIG)
    contacts = []
    for index, spec in enumerate(RIG.fingers[:fingers]):
        own = reach.of_finger(index)
        contacts.append(_felt(reach.approaches[own[len(own) // 2]], spec.name, placed, rng))
    return contacts


def told(ended: Ended) -> dict[str, Any]:
    """The JSON of a run, which must be as its schema says."""
    found = ended.json
    assert violations(found, json.loads(schema_text("grip"))) == []
    return found


def at_hypotheses(found: Mapping[str, Any]) -> Iterator[tuple[int, Placed]]:
    """Every hypothesis's object where its configuration puts it."""
    for index, item in enumerate(found["hypotheses"]):
        at = item["configuration"]
        yield index, Placed(MODELS[item["object"]], at["x"], at["y"], at["theta"])


def outside(interval: Sequence[float], angle: float) -> float:
    """By how much an angle is outside an interval of angles, rad."""
    lo, hi = interval
    return abs(math.remainder(angle - (lo + hi) / 2, 2 * math.pi)) - (hi - lo) / 2


PARTS = [("hand", 3), ("gator", 3), ("tr-2", 2), ("grip", 1)]


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize(("name", "fingers"), sample(PARTS, [PARTS[0], PARTS[2], PARTS[3]]))
def test_predictions_agree_with_brute_force(ask: Here, strategy: str, name: str, fingers: int) -> None:
    """At each hypothesis's own configuration; for every other one the path is off by its whole bound."""
    rng = np.random.default_rng([3, fingers, len(name)])
    grip = first_grip(place(MODELS[name], rng), rng, fingers)
    assert any(contact.touched for contact in grip)
    found = told(ask([grip], "--strategy", strategy, "--json"))
    assert found["strategy"] == strategy
    assert found["approaches"]
    names = [item["finger"] for item in found["approaches"]]
    assert names == sorted(set(names))
    compared = 0
    for approach in found["approaches"]:
        assert [item["hypothesis"] for item in approach["predictions"]] == [*range(len(found["hypotheses"]))]
        heading = unit(approach["direction"])
        for index, placed in at_hypotheses(found):
            item = approach["predictions"][index]
            start = np.array(approach["start"])
            if index % 2:
                angle = rng.uniform(0, 2 * math.pi)
                start += approach["position_bound"] * unit(angle)
            at = stop(placed.shape, start, approach["direction"], 5.0, approach["travel"])
            if not math.isfinite(at):
                assert item["may_miss"]
                continue
            compared += 1
            assert item["stop"][0] <= at <= item["stop"][1]
            assert outside(item["normal"], outward_normal(placed.shape, start + at * heading)) <= 1e-6
    assert compared


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("name", sample(["tr-3", "hand"], ["hand"]))
def test_carrying_out_plan_after_plan_finds_the_part(ask: Here, strategy: str, name: str) -> None:
    """Nothing but the command chooses; the truth is never lost, and one hypothesis is left in the end."""
    rng = np.random.default_rng(11)
    placed = place(MODELS[name], rng)
    grips = [first_grip(placed, rng)]
    for number in range(8):
        ended = ask(grips, "--strategy", strategy, "--seed", number, "--json")
        found = told(ended)
        assert any(holds(item, placed) for item in found["hypotheses"])
        assert ended.code == 0
        if not found["approaches"]:
            break
        for item in found["approaches"]:
            for contact in (contact for grip in grips for contact in grip if contact.name == item["finger"]):
                again = math.remainder(contact.direction_rad - item["direction"], math.tau)
                assert abs(again) > 0.01, "no approach is carried out again"
        grips.append(carried_out(found["approaches"], placed, rng))
    assert len(grips) > 1
    assert (found["verdict"], found["approaches"]) == ("unique", [])
    said = ask(grips, "--strategy", strategy).out
    assert ("no grip is needed" if found["fine"] else "no approach that is left") in said
    bounds = found["hypotheses"][0]["bounds"]
    wide = max(bounds[key][1] - bounds[key][0] for key in ("x", "y"))
    assert found["fine"] <= (wide <= 2 * RIG.search.goal_position_mm)


def holds(item: Mapping[str, Any], placed: Placed) -> bool:
    """Whether a hypothesis's bounds contain the truth, or what symmetry makes equal to it."""
    if item["object"] != placed.model.name:
        return False
    (state,) = Catalogue([placed.model]).states
    bounds = item["bounds"]
    return any(
        all(bounds[key][0] <= value <= bounds[key][1] for key, value in (("x", x), ("y", y), ("theta", turn)))
        for x, y, turn in equivalent_configurations(placed, state.symmetry_order, state.origin_mm)
    )


def twins_file(folder: Path) -> Path:
    content = json.loads(SHIPPED_OBJECTS.read_text())
    (hand,) = [item for item in content["objects"] if item["name"] == "hand"]
    content["objects"].append(hand | {"name": "other [hand]"})
    file = folder / "twins.json"
    file.write_text(json.dumps(content))
    return file


def test_twins_are_called_indistinguishable(ask: Here, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    placed = place(MODELS["hand"], rng)
    first = first_grip(placed, rng)
    planned = told(ask([first], "--json"))["approaches"]
    grips = [first, carried_out(planned, placed, rng)]
    ended = ask(grips, "--objects", twins_file(tmp_path), "--json")
    found = told(ended)
    assert [item["object"] for item in found["hypotheses"]] == ["hand", "other [hand]"]
    assert found["indistinguishable"] == [[0, 1]]
    assert ended.code == 1
    ended = ask(grips, "--objects", twins_file(tmp_path))
    assert ended.code == 1
    assert "no approach within reach distinguishes" in ended.out
    assert "indistinguishable within reach: a and b\n" in ended.out
    assert "other [hand]" in ended.out


def test_hypotheses_that_can_be_told_apart_are_not_called_indistinguishable(ask: Here) -> None:
    rng = np.random.default_rng(6)
    found = told(ask([first_grip(place(MODELS["tr-2"], rng), rng, 2)], "--json"))
    assert found["verdict"] == "ambiguous"
    assert found["indistinguishable"] == []


@pytest.mark.parametrize("seed", range(20))
def test_sets_alike_hold_every_pair_that_is_alike_and_no_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 12))
    alike = np.triu(rng.uniform(size=(count, count)) < rng.choice([0.2, 0.6, 1.0]), 1)
    alike |= alike.T | np.eye(count, dtype=bool)
    found = np.eye(count, dtype=bool)
    for group in indistinguishable_sets(alike):
        assert len(group) > 1
        assert list(group) == sorted(set(group))
        found[np.ix_(group, group)] = True
    np.testing.assert_array_equal(found, alike)


def test_nothing_fits(ask: Here) -> None:
    rng = np.random.default_rng(9)
    placed = place(MODELS["grip"], rng)
    elsewhere = replace(placed, x=placed.x + 12.0, theta=placed.theta + 0.5)
    grips = [first_grip(placed, rng), first_grip(elsewhere, rng)]
    ended = ask(grips, "--json")
    found = told(ended)
    assert ended.code == 1
    assert (found["verdict"], found["hypotheses"], found["approaches"]) == ("none", [], [])
    assert (found["fine"], found["decisive"], found["remaining"], found["seconds"]) == (
        False,
        None,
        None,
        None,
    )
    ended = ask(grips)
    assert ended.code == 1
    assert "nothing in the catalogue fits all contacts\n" in ended.out
    assert "the object may have moved after grip 1\n" in ended.out


def test_random_is_the_same_again_by_seed(ask: Here) -> None:
    rng = np.random.default_rng(12)
    grip = first_grip(place(MODELS["gator"], rng), rng)
    runs = [ask([grip], "--strategy", "random", "--seed", seed, "--json").out for seed in (1, 1, 2)]
    assert runs[0] == runs[1]
    assert json.loads(runs[0])["approaches"] != json.loads(runs[2])["approaches"]
    planned = [ask([grip], "--seed", seed, "--json").out for seed in (1, 2)]
    assert planned[0] == planned[1]
    assert json.loads(runs[0])["remaining"] is None
    assert 0 <= json.loads(planned[0])["remaining"] <= 1


@pytest.mark.parametrize("columns", [60, 120])
@pytest.mark.parametrize(("fingers", "strategy"), [(1, "planned"), (2, "random"), (3, "random")])
def test_the_table_fits_and_its_numbers_hold(
    ask: Here, monkeypatch: pytest.MonkeyPatch, columns: int, fingers: int, strategy: str
) -> None:
    rng = np.random.default_rng([14, fingers])
    grip = first_grip(place(MODELS["hand"], rng), rng, fingers)
    monkeypatch.setenv("COLUMNS", str(columns))
    found = told(ask([grip], "--strategy", strategy, "--json"))
    ended = ask([grip], "--strategy", strategy)
    assert ended.code == 0
    assert max(len(line) for line in ended.out.splitlines()) <= columns
    shown = len(found["hypotheses"][:12])
    pattern = re.compile(r"(−?\d+\.\d) … (−?\d+\.\d) mm")
    read = {tuple(float(value.replace("−", "-")) for value in pair) for pair in pattern.findall(ended.out)}
    for approach in found["approaches"]:
        for item in approach["predictions"][:shown]:
            if item["stop"] is not None:
                lo, hi = item["stop"]
                assert any(lo - 0.11 < a <= lo and hi <= b < hi + 0.11 for a, b in read)
    hidden = len(found["hypotheses"]) - shown
    assert (f"and {hidden} more hypotheses; the JSON lists them all" in ended.out) == (hidden > 0)


def test_a_decisive_grip_says_what_that_rests_on(ask: Here) -> None:
    """Among some first grips there are plans of both kinds; each says of itself what it is."""
    kinds = set()
    for seed in range(40):
        rng = np.random.default_rng([15, seed])
        grip = first_grip(place(MODELS["tr-2"], rng), rng)
        if sum(contact.touched for contact in grip) < 3:
            continue
        found = told(ask([grip], "--json"))
        if found["verdict"] != "ambiguous" or not found["approaches"]:
            continue
        said = ask([grip]).out
        if found["decisive"]:
            assert "\ndecisive: every outcome leaves one hypothesis, if contacts are within" in said
            bluntest = max(item["position_bound"] for item in found["approaches"])
            down = math.floor(bluntest * 100) / 100
            assert f"± {down:.2f} mm and ± 12.6°" in " ".join(said.split())
            assert math.degrees(found["assumes"]["normal_half_range"]) == pytest.approx(12.672, abs=1e-3)
        else:
            assert "\nnot decisive: " in said
        kinds.add(found["decisive"])
        if kinds == {True, False}:
            break
    assert kinds == {True, False}


def test_a_picture_is_drawn_in_every_case(ask: Here, tmp_path: Path) -> None:
    rng = np.random.default_rng(16)
    placed = place(MODELS["hand"], rng)
    grip = first_grip(placed, rng)
    elsewhere = first_grip(replace(placed, x=placed.x + 15.0, theta=placed.theta + 0.6), rng)
    for grips, title in (([grip], "Next grip: "), ([grip, elsewhere], "No next grip")):
        ask(grips, "--picture", tmp_path / "plan.svg", "--json")
        drawn = (tmp_path / "plan.svg").read_text()
        assert drawn.startswith("<svg")
        assert title in drawn
        assert "felt.json on rig bench" in drawn


def untouched() -> list[Contact]:
    return [Contact("f1", Finger(5.0, 10.0), False, (0.0, 130.0), (0.0, -100.0), 0.5)]


def other_finger() -> list[Contact]:
    return [Contact("thumb", Finger(4.0, 10.0), True, (0.0, 130.0), (0.0, 20.0), 0.5)]


@pytest.mark.parametrize(
    ("grip", "options", "said"),
    [
        (untouched(), (), "no finger touched anything"),
        (other_finger(), (), 'thumb has a tip of radius 4 mm at height 10 mm; rig "bench" has none like it'),
        (untouched(), ("--strategy", "clever"), "'clever' is not one of 'planned', 'random', 'rotate'"),
    ],
)
def test_bad_input_is_one_line(ask: Here, grip: list[Contact], options: Sequence[str], said: str) -> None:
    ended = ask([grip], *options, "--json")
    assert ended.code == 2
    assert ended.out == ""
    assert ended.err.count("\n") == 1
    assert said in ended.err


def test_the_example(here: Here) -> None:
    example = EXAMPLES / "first-grip.json"
    found = told(here("plan", "--contacts", example, "--json"))
    assert [item["object"] for item in found["hypotheses"]] == ["hand", "hand"]
    assert found["approaches"]
