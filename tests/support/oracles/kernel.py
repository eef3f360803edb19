"""The recogniser with and without its compiled kernel."""

import hashlib
import json
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from palpate.base.array_cache import Cache
from palpate.base.geometry import ObjectModel
from palpate.config.objects_file import load_objects
from palpate.recognizer import Catalogue, Finger
from palpate.recognizer.compiled import KERNEL
from palpate.rig.catalogue.preparation import prepare_catalogue
from support.campaign.objects import drawn_objects, objects_of

# ----------------------------------------------------------------------------------------------------
# The recogniser without its compiled kernel, for a while: the kernel has to match what numpy computes.

needs_kernel = pytest.mark.skipif(KERNEL is None, reason="the compiled kernel is not built, or is off")


@contextmanager
def without_kernel(*modules: str) -> Iterator[None]:
    """These modules of the recogniser compute with numpy alone; all of them if none is named.

    Then catalogues are not to be shared with the outside: what they keep for the kernel would be missing.
    """
    found = {
        name.removeprefix("palpate.recognizer."): module
        for name, module in list(sys.modules.items())
        if name.startswith("palpate.recognizer.") and hasattr(module, "KERNEL")
    }
    users = [found[name] for name in modules or found]
    before = [module.KERNEL for module in users]
    try:
        for module in users:
            module.KERNEL = None
        yield
    finally:
        for module, kernel in zip(users, before, strict=True):
            module.KERNEL = kernel


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
