"""Values that users of the front door make and print: contacts, approaches, hypotheses."""

import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import pytest
import trimesh

import palpate
from palpate.recognizer import Hypothesis
from support.benches.parts import mesh_file
from support.benches.rigs import quick_bench
from support.commands.repository import EXAMPLES, ROOT

FINGER = palpate.Finger(5.0, 10.0)


@pytest.fixture(scope="module")
def hypothesis() -> Hypothesis:
    """The hypothesis that the example's contacts leave."""
    return palpate.recognise(None, EXAMPLES / "contacts.json").hypotheses[0]


def test_a_hypothesis_shows_object_pose_and_bounds_that_hold(hypothesis: Hypothesis) -> None:
    shown, bounds, at = repr(hypothesis), hypothesis.bounds, hypothesis.configuration
    assert f"{hypothesis.state.object_name}/{hypothesis.state.state.name}" in shown
    intervals = [bounds.x_mm, bounds.y_mm, tuple(map(math.degrees, bounds.theta_rad))]
    for name, value, (lo, hi) in zip(
        ("x", "y", "theta"), (at.x_mm, at.y_mm, math.degrees(at.theta_rad)), intervals, strict=True
    ):
        middle, half = shown.split(f" {name}=")[1].split(",")[0].rstrip(" m°").split("±")
        assert float(middle) == pytest.approx(value, abs=0.0051)
        assert float(middle) - float(half) <= lo + 1e-6
        assert float(middle) + float(half) >= hi - 1e-6


def test_contacts_and_approaches_show_where_they_are() -> None:
    normals = palpate.NormalRange(math.radians(430), math.radians(450))
    contact = palpate.Contact("f1", FINGER, True, (3.0, 145.114), (10.0, 40.726), 0.2, normals)
    for part in ("f1", "touched", "(10.00, 40.73)", "(3.00, 145.11)", "70.0° to 90.0°"):
        assert part in repr(contact)
    assert "missed" in repr(palpate.Contact("f1", FINGER, False, (0.0, 1.0), (0.0, 2.0), 0.2))
    approach = palpate.FingerApproach(FINGER, (3.0, 145.114), math.radians(-95), 80.0, 0.2, finger_index=1)
    for part in ("finger_index=1", "(3.00, 145.11)", "-95.0°", "80.00"):
        assert part in repr(approach)


def test_values_of_wrong_kinds_have_a_repr_as_well() -> None:
    for value in (
        palpate.FingerApproach(FINGER, ("a", None), "x", 10.0, 0.2),  # type: ignore[arg-type]
        palpate.Contact("f1", FINGER, True, (0.0, 1.0), (0.0, 2.0), 0.2, (1.0, 2.0)),  # type: ignore[arg-type]
        object.__new__(palpate.Contact),
        object.__new__(Hypothesis),
    ):
        assert "\n" not in repr(value)


def test_the_import_on_the_page_runs(
    read_here: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = re.search(r"`(palpate\.import_objects\(.*?\))`", (ROOT / "docs/python.md").read_text("utf-8"))
    assert shown is not None
    mesh_file(trimesh.creation.box((30, 20, 10)), tmp_path / "part.stl")
    monkeypatch.chdir(tmp_path)
    objects = eval(shown[1], {"palpate": palpate})
    assert [item.name for item in objects.objects] == ["part"]
    lying = palpate.import_objects("part.stl", units="mm", states="as-is", name="angle", heights_mm=[(1, 3)])
    assert [(item.name, len(item.states)) for item in lying.objects] == [("angle", 1)]


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"unit": "mm"}, "units"),
        ({"units": "furlong"}, "inch"),
        ({"units": "mm", "tolerance_mm": -1.0}, "tolerance_mm"),
        ({"units": "mm", "heights_mm": [(5.0, 2.0)]}, "heights_mm"),
        ({"units": "mm", "heights_mm": [("a", 2.0)]}, "heights_mm"),
    ],
)
def test_wrong_settings_of_an_import_are_input_errors(settings: dict[str, Any], named: str) -> None:
    with pytest.raises(palpate.InputError, match=named):
        palpate.import_objects("part.stl", **settings)


@pytest.mark.parametrize(
    "kind", [palpate.Contact, palpate.FingerApproach, palpate.NormalRange, palpate.Finger]
)
def test_the_page_has_every_field(kind: type) -> None:
    page = (ROOT / "docs/python.md").read_text("utf-8")
    table = page.split(f"| `{kind.__name__}` | unit |")[1].split("\n\n")[0]
    names = re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (`.*?) \|", table, re.M)))
    assert names == [field.name for field in dataclasses.fields(kind)]


def test_contacts_are_traced_to_their_fingers_as_the_page_shows(tmp_path: Path) -> None:
    page = (ROOT / "docs/python.md").read_text("utf-8")
    code = next(block for block in re.findall(r"```python\n(.*?)```", page, re.S) if "grip.touches" in block)
    rig_file, parts = quick_bench(tmp_path)
    with palpate.open_rig(rig_file, seed=7).connect(parts) as rig:
        approaches = rig.plan(rig.recognise(parts))
        names: dict[str, Any] = {"rig": rig, "approaches": approaches}
        exec(code, names)
    assert [touch.contact.name for touch in names["grip"].touches][-1] == names["name"]
