"""Object models from Python: imported from CAD files, drawn, and checked for what a rig cannot tell apart."""

from collections.abc import Callable
from pathlib import Path

from palpate.api.files import PathLike
from palpate.config import ObjectsFile
from palpate.config.objects_file import checked_objects
from palpate.config.objects_tables import ObjectsFileText
from palpate.rig.catalogue.cad_import import ImportOptions, import_file

__all__ = ["import_objects"]


def import_objects(
    path: PathLike, options: ImportOptions | None = None, *, progress: Callable[[str], None] = lambda _: None
) -> ObjectsFile:
    """Import object models from a CAD file: stable states and their cross sections.

    STL, OBJ, PLY, 3MF, STEP, DXF, SVG; `options` as `palpate objects import` has them. Raises InputError,
    with the place, for surfaces that are not closed, open outlines, files without units and the like.
    """
    imported = import_file(Path(path), options or ImportOptions(), progress)
    tables = [item.text for item in imported.objects]
    text = ObjectsFileText(format="palpate/objects@1", units="mm", objects=tables)
    return checked_objects(text, str(path))
