"""States that no section can be given within the tolerance are left out, and counted."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh

from palpate.base.errors import InputError
from palpate.cad.parts import Solid
from palpate.rig.catalogue.cad_import import ImportOptions, LossError, import_file
from palpate.rig.catalogue.import_states import ImportedStates, Shares, import_states
from support.benches.parts import mesh_file, prism

RAMP = shapely.Polygon([(0, 0), (100, 0), (0, 14)])
"""A wall of it leans by 82° where it lies on its back."""


def states_of(mesh: trimesh.Trimesh, off_mm: float, heights: tuple[float, ...] | None) -> ImportedStates:
    solid = Solid("ramp", np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int64), off_mm)
    return import_states(solid, Shares(0.1, 0.01, heights, 0.01, as_is=False), lambda _: None)


@pytest.mark.parametrize("heights", [(10.0,), None])
def test_a_state_without_a_section_costs_no_other(heights: tuple[float, ...] | None) -> None:
    found = states_of(prism(RAMP, 60.0), 0.03, heights)
    ends = [item for item in found.states if item.result.height == 60.0]
    assert len(ends) == 2
    (lost,) = (item for item in found.left_out if item.reason.startswith("no section can be given"))
    assert lost.reason.endswith("as a wall that leans moves too far where its surface is off by 0.03 mm")
    shares = [item.result.probability for item in found.states] + [
        item.probability for item in found.left_out
    ]
    assert sum(shares) == pytest.approx(1.0, abs=1e-5)
    exact = states_of(prism(RAMP, 60.0), 0.0, (10.0,))
    assert len(exact.states) == len(found.states) + lost.states


def test_a_part_without_any_section_is_refused_and_says_why() -> None:
    needle = trimesh.creation.cone(10, 20, sections=3)
    with pytest.raises(
        InputError, match=r"^ramp: in each of its states no section can .* by 0.09 mm; give a"
    ):
        states_of(needle, 0.09, (10.0,))


def test_no_more_is_lost_than_is_accepted(tmp_path: Path) -> None:
    path = mesh_file(prism(RAMP, 60.0), tmp_path / "ramp.stl")
    options = ImportOptions(units="mm", tolerance_mm=0.0005, heights_mm=(10.0,))
    with pytest.raises(LossError, match=r"in states that are left out in \d+ % of cases"):
        import_file(path, options)
    (accepted,) = import_file(path, replace(options, accept_loss=True)).objects
    assert accepted.result.states
    assert sum(item.probability for item in accepted.result.left_out) > 0.2
