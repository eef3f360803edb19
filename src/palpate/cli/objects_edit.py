"""`palpate objects remove`, `rename` and `merge`: edits of objects files."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.interruption import if_interrupted
from palpate.cli.options import ObjectsArgument

__all__ = ["merge", "remove", "rename"]


@if_interrupted("the file is as it was")
def remove(
    file: ObjectsArgument,
    names: Annotated[list[str], typer.Argument(metavar="NAME…", show_default=False)],
) -> None:
    """Remove objects from an objects file.

    An imported object comes back with the next import of its folder, unless its CAD file is moved away.
    """
    from palpate.base.errors import counted
    from palpate.cli.objects_file import load_for_edit, write_edited
    from palpate.config.objects_edits import remove_objects

    before = load_for_edit(file)
    after = remove_objects(before, names, str(file))
    write_edited(file, after)
    removed = counted(len(before.objects) - len(after.objects), "object", "objects")
    typer.echo(f"{removed} removed, {len(after.objects)} left in {file}")


@if_interrupted("the file is as it was")
def rename(
    file: ObjectsArgument,
    old: Annotated[str, typer.Argument(metavar="NAME", show_default=False)],
    new: Annotated[str, typer.Argument(metavar="NEW", show_default=False)],
) -> None:
    """Rename an object of an objects file. Scenes and scripts that name it are not changed."""
    from palpate.cli.objects_file import check_name, load_for_edit, write_edited
    from palpate.config.objects_edits import rename_object

    check_name("NEW", new)
    write_edited(file, rename_object(load_for_edit(file), old, new, str(file)))
    typer.echo(f"{old} is now {new} in {file}")


@if_interrupted("nothing was written")
def merge(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE…", help="Objects files (JSON).", show_default=False)
    ],
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="The new objects file.", show_default=False)
    ],
) -> None:
    """Merge objects files into a new one. Two different objects of one name are refused."""
    from palpate.base.errors import InputError, counted
    from palpate.cli.objects_file import load_for_edit, write_edited
    from palpate.config.objects_edits import merge_objects

    if out.exists():
        raise InputError(f"{out} is there already; choose another with --out")
    made = merge_objects([(file, load_for_edit(file)) for file in files], out)
    write_edited(out, made)
    typer.echo(f"{counted(len(made.objects), 'object', 'objects')} in {out}")
