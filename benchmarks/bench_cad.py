"""CAD files become a catalogue, and every state of every object in it is identified on the emulated bench.

    python benchmarks/bench_cad.py ../shared/data/cad
    python benchmarks/bench_cad.py FOLDER --heights 5,10 --seeds 2

The catalogue is what `palpate objects import` makes of the folder's solids near the fingers' heights. What
lies on the table is cut from the same meshes by trimesh at exactly these heights, so that the import's
slabs, simplified outlines and merged states are put to the test as well. The firm rig has its fingers at
the heights given, in turn. A run is right if the object and its state are named and the truth is inside the
bounds, or if it is called indistinguishable from others and the truth is among them. Ends with exit code 1 if
any run was wrong.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
import trimesh

from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.base.vocabulary import Strategy
from palpate.cad.parts import Solid
from palpate.cad.readers import read_solids
from palpate.config import ObjectsFile, RigFile, load_rig
from palpate.config.catalogue_results import ImportedStateOut
from palpate.config.objects_file import objects_from_text
from palpate.config.objects_tables import ObjectsFileText
from palpate.recognizer import Catalogue
from palpate.rig.bench import environment, set_up
from palpate.rig.catalogue.cad_import import ImportOptions, import_file
from palpate.rig.catalogue.finger_model import check_known
from palpate.rig.emulated.scene import draw_placement
from palpate.rig.identification.result import IdentificationJob
from palpate.rig.session.run import run_identification

FIRM_RIG = Path(__file__).parent.parent / "examples" / "firm-rig.toml"

INCHES = ("angle_block", "featuretype")
ABOUT_MM = 0.01


@dataclass(frozen=True, eq=False)
class Lying:
    """One state of one object, as trimesh cuts it."""

    model: ObjectModel
    top_mm: float


def solids_in(folder: Path, wanted_mm: tuple[float, ...]) -> tuple[ObjectsFile, list[Lying]]:
    """The catalogue of a folder, and what may lie on the table."""
    texts, lying = [], []
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in {".stl", ".obj", ".ply", ".3mf"}:
            continue
        units = "inch" if path.stem in INCHES else "mm"
        begin = time.perf_counter()
        try:
            found = import_file(path, ImportOptions(units=units, heights_mm=wanted_mm))
        except InputError as error:
            print(f"{path.name}: refused: {error}")
            continue
        print(f"{path.name}: imported in {time.perf_counter() - begin:.1f} s")
        for solid, item in zip(read_solids(path, units, 0.01).solids, found.objects, strict=True):
            texts.append(item.text)
            text = item.text
            lying += [cut(solid, text.name, text.tolerance, state, wanted_mm) for state in item.told.states]
    file = ObjectsFileText(format="palpate/objects@1", units="mm", objects=texts)
    return objects_from_text(file, "catalogue"), lying


def cut(
    solid: Solid, name: str, tolerance: float, state: ImportedStateOut, heights: Sequence[float]
) -> Lying:
    """The exact sections of a state at the fingers' heights."""
    frame = state.frame
    resting = solid.vertices_mm @ np.array(frame.rotation).T + np.array(frame.offset)
    mesh = trimesh.Trimesh(resting, solid.faces, process=False)
    sections = []
    for height in heights:
        path = mesh.section(plane_origin=[0.0, 0.0, height], plane_normal=[0.0, 0.0, 1.0])
        if path is None:
            continue
        region: shapely.Geometry = shapely.Polygon()
        for loop in path.discrete:
            region = region.symmetric_difference(shapely.Polygon(loop[:, :2]))
        polygons = tuple(
            Polygon(
                np.asarray(part.exterior.coords)[:-1],
                tuple(np.asarray(hole.coords)[:-1] for hole in part.interiors),
            )
            for part in shapely.get_parts(region.simplify(1e-7))
            if part.area > 1e-6
        )
        sections.append(Section((height - ABOUT_MM, height + ABOUT_MM), polygons))
    top = float(resting[:, 2].max())
    return Lying(ObjectModel(name, (State(state.name, tuple(sections), height_mm=top),), tolerance), top)


def at_heights(rig: RigFile, heights: Sequence[float]) -> RigFile:
    """The rig with its fingers at these heights in turn."""
    fingers = [
        finger.model_copy(update={"height_mm": heights[k % len(heights)]})
        for k, finger in enumerate(rig.fingers)
    ]
    return rig.model_copy(update={"fingers": fingers})


def identified(rig: RigFile, catalogue: Catalogue, item: Lying, seed: int) -> tuple[str, bool]:
    """How one run ended, in words, and whether it was right."""
    assert rig.emulation is not None
    lying = draw_placement(
        ObjectsFile((item.model,)), rig.emulation.placement_radius_mm, np.random.default_rng([seed, 0])
    )
    bench = set_up(rig, [lying], seed)
    begin = time.perf_counter()
    out = run_identification(
        IdentificationJob(rig, catalogue, (lying,), Strategy.PLANNED, seed, None), environment(bench)
    ).out(wall_seconds=0.0, session=None)
    truth = out.truth
    right = truth is not None and truth.named and truth.inside_bounds
    right = right and out.verdict.value in {"identified", "indistinguishable"}
    error = "" if truth is None or truth.position_error_mm is None else f", {truth.position_error_mm:.2f} mm"
    words = f"{out.verdict.value}{error}, {out.grips} grips, {time.perf_counter() - begin:.0f} s"
    return words, bool(right)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--heights", default="5,10")
    parser.add_argument("--seeds", type=int, default=1)
    args = parser.parse_args()
    heights = tuple(float(part) for part in args.heights.split(","))
    objects, lying = solids_in(args.folder, heights)
    rig = at_heights(load_rig(FIRM_RIG), heights)
    check_known(objects.objects, rig.fingers)
    catalogue = Catalogue(objects.objects)
    wrong = 0
    for item in lying:
        for seed in range(args.seeds):
            words, right = identified(rig, catalogue, item, seed)
            wrong += not right
            name = f"{item.model.name}/{item.model.states[0].name}"
            print(f"{name:28s} seed {seed}: {words}{'' if right else '  WRONG'}", flush=True)
    print(f"{len(lying) * args.seeds - wrong} of {len(lying) * args.seeds} right")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
