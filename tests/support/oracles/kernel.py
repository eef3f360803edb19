"""Both sides of the steps, kernel calls that only tests make, and the bits of a prepared catalogue."""

import hashlib
import json
import struct
import sys
from dataclasses import fields, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType

import numpy as np

from palpate.base.array_cache import Cache
from palpate.base.geometry import Ints, ObjectModel
from palpate.config.objects_file import load_objects
from palpate.recognizer import Catalogue, Finger, numpy_steps
from palpate.recognizer.constraints import Constraints
from palpate.recognizer.interpretations import Query
from palpate.recognizer.pose_region import Cells
from palpate.recognizer.steps import Steps
from palpate.recognizer.verification import Poses, Verification
from palpate.rig.catalogue.preparation import prepare_catalogue
from support.campaign.objects import drawn_objects, objects_of

BUILT = find_spec("palpate.recognizer._kernel") is not None
"""True if there was a C compiler."""


def both_sides() -> tuple[Steps, ...]:
    """Numpy's steps and, where they are built, the compiled ones."""
    return (numpy_steps, _steps()) if BUILT else (numpy_steps,)


# ----------------------------------------------------------------------------------------------------
# Judgements that the kernel makes within its rounds, asked for by themselves.


def compiled_verify(evidence: Query, poses: Poses, skipped: np.ndarray | None = None) -> Verification:
    """What `verify` says, by the kernel."""
    shape = (len(poses), len(evidence.contacts))
    fits, holds, gap, offset, normal, limited = _kernel().verify(
        _steps().evidence_arrays(evidence), *_rows(poses), len(poses), skipped
    )
    return Verification(
        np.frombuffer(fits, dtype=bool).reshape(shape),
        np.frombuffer(holds, dtype=bool),
        np.frombuffer(gap).reshape(shape),
        np.frombuffer(offset).reshape(*shape, 2),
        np.frombuffer(normal).reshape(*shape, 2),
        np.frombuffer(limited, dtype=bool).reshape(shape),
    )


def compiled_polish(
    constraints: Constraints, cells: Cells, first: Ints, region: Ints, cell: Ints, poses: Poses
) -> tuple[Poses, np.ndarray]:
    """What `polish` gives, by the kernel."""
    null, skipped = constraints.nodes.edges < 0, constraints.null_rows(cells.node[cell])
    rows = [np.ascontiguousarray(item) for item in (cells.node, cells.lo, cells.hi, cells.polygon, first)]
    regions = (
        *rows,
        None if skipped is None else np.ascontiguousarray(null),
        *cells.polygon.shape[:2],
        len(first) - 1,
        *null.shape,
    )
    theta, position, holds = _kernel().polish(
        _steps().evidence_arrays(constraints.evidence),
        regions,
        np.ascontiguousarray(region),
        np.ascontiguousarray(cell),
        *_rows(poses),
        len(region),
        skipped,
    )
    polished = Poses(poses.state, np.frombuffer(theta), np.frombuffer(position).reshape(-1, 2))
    return polished, np.frombuffer(holds, dtype=bool)


def _rows(poses: Poses) -> list[np.ndarray]:
    return [np.ascontiguousarray(item) for item in (poses.state, poses.theta, poses.position)]


def _kernel() -> ModuleType:
    return import_module("palpate.recognizer._kernel")


def _steps() -> ModuleType:
    return import_module("palpate.recognizer.compiled_steps")


# ----------------------------------------------------------------------------------------------------
# What is prepared of a catalogue, as bytes: equal if and only if every number is, to the last bit.

FINGERS = (Finger(0.0, 5.0), Finger(4.0, 5.0))


def bits_of(catalogue: Catalogue, fingers: tuple[Finger, ...] = FINGERS) -> dict[str, bytes]:
    """By name: states, edges, outlines, boundaries; type, shape, strides and bytes of each array."""
    found = {"reach": _bits(catalogue.reach_mm), "origins": _bits(catalogue.origins_mm)}
    for number, state in enumerate(catalogue.states):
        bound, own = state.normal_bound_rad, state.symmetry
        numbers = (
            own.order,
            own.off_mm,
            own.lean_rad,
            state.tolerance_mm,
            np.nan if bound is None else bound,
        )
        found[f"state {number}"] = f"{state.object_name}/{state.state.name}".encode() + struct.pack(
            "5d", *numbers
        )
        rings = [ring for section in state.state.sections for ring in section.rings]
        found[f"rings {number}"] = b"".join(map(_bits, rings))
    for finger in fingers:
        edges, outlines = catalogue.edges(finger), catalogue.outlines(finger)
        found[f"same {finger}"] = bytes([edges is outlines])
        boundary = catalogue.boundary(finger)
        tables = {"edges": edges, "outlines": outlines, "pieces": boundary.pieces, "sides": boundary.sides}
        for name, table in tables.items():
            for item in fields(table):
                found[f"{name}.{item.name} {finger}"] = _bits(getattr(table, item.name))
        found[f"supports {finger}"] = _bits(outlines.supports)
        for name in ("first_piece", "first_side", "radius_mm", "clearance_mm"):
            found[f"{name} {finger}"] = _bits(getattr(boundary, name))
    return found


def _bits(array: np.ndarray) -> bytes:
    return repr((array.dtype, array.shape, array.strides)).encode() + array.tobytes()


def drawn_catalogue(seed: int, *, exact: bool = False, least_vertices: int = 0) -> list[ObjectModel]:
    """Objects of every kind: drawn, stacked, symmetric, of several polygons, round; `exact`: no tolerance."""
    rng = np.random.default_rng(seed)
    chosen = [*objects_of("own"), *round_objects(), *([] if exact else objects_of("loose"))]
    while not chosen or sum(map(_vertices, chosen)) < least_vertices:
        chosen += [item for item in drawn_objects(rng, 4.0) if not exact or item.tolerance_mm == 0]
    if exact:
        chosen = [item for item in chosen if not any(state.curves_off_mm for state in item.states)]
    rng.shuffle(chosen)
    return [_renamed(item, number) for number, item in enumerate(chosen)]


def round_objects() -> tuple[ObjectModel, ...]:
    """A round part, one with a hole beside its middle, and one of arcs."""
    circle = {"circle": {"centre": [3.0, -2.0], "radius": 21.0}}
    hole = {"circle": {"centre": [9.0, 1.0], "radius": 5.5}}
    arcs = [[0.0, 0.0, 0.3], [40.0, 0.0], [40.0, 25.0, -0.2], [0.0, 25.0]]
    polygons = {
        "disc": {"outer": circle},
        "eccentric": {"outer": circle, "holes": [hole]},
        "arcs": {"outer": arcs},
    }
    entries = [
        {
            "name": name,
            "tolerance": tolerance,
            "states": [{"name": "flat", "sections": [{"z": [0, 20], "polygons": [polygon]}]}],
        }
        for (name, polygon), tolerance in zip(polygons.items(), (0.1, 0.0, 0.05), strict=True)
    ]
    return _loaded({"format": "palpate/objects@1", "units": "mm", "objects": entries})


def _loaded(tables: dict[str, object]) -> tuple[ObjectModel, ...]:
    with TemporaryDirectory() as folder:
        path = Path(folder, "objects.json")
        path.write_text(json.dumps(tables))
        return load_objects(path).objects


def _renamed(item: ObjectModel, number: int) -> ObjectModel:
    return replace(item, name=f"{number} {item.name}")


def _vertices(item: ObjectModel) -> int:
    return sum(len(ring) for state in item.states for section in state.sections for ring in section.rings)


def main(folder: str, seed: str, task: str) -> None:
    """In a process of its own: prepare with a cache and print a digest. Task "keep": keep on keeping."""
    cache = Cache(Path(folder))
    catalogue = prepare_catalogue(drawn_catalogue(int(seed), least_vertices=2500), FINGERS, cache=cache)
    sys.stdout.write(f"{digest(catalogue)}\n")
    sys.stdout.flush()
    while task == "keep":
        for path in Path(folder).glob("*.arrays"):
            kind, _, key = path.stem.rpartition("-")
            arrays = cache.fetch(kind, key)
            if arrays is not None:
                cache.keep(kind, key, arrays)


def digest(catalogue: Catalogue) -> str:
    """Of all bits."""
    return hashlib.sha256(repr(sorted(bits_of(catalogue).items())).encode()).hexdigest()


if __name__ == "__main__":
    main(*sys.argv[1:])
