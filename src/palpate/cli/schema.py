"""`palpate schema`: the JSON Schemas of palpate's files, for editors and for programs."""

from pathlib import Path
from typing import Annotated

import typer

__all__ = ["schema"]


def schema(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="Of a format; without it, all names are listed.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Write it here instead of printing it.")
    ] = None,
) -> int:
    """Print the JSON Schema of a file format, or write it where an editor finds it.

    A rig file whose first line is `#:schema ./rig.schema.json` is checked and completed by editors that know
    TOML, after `palpate schema rig --out rig.schema.json` beside it.
    """
    from palpate.base.errors import InputError
    from palpate.base.files.writing import check_place, write_text
    from palpate.config.schema import FORMATS, schema_text

    if name is None:
        if out is not None:
            raise InputError("--out is for one schema: name it")
        typer.echo("\n".join(sorted(FORMATS)))
        return 0
    if name not in FORMATS:
        raise InputError(f'there is no format "{name}"; there are {", ".join(sorted(FORMATS))}')
    if out is None:
        typer.echo(schema_text(name), nl=False)
        return 0
    check_place(out)
    write_text(out, schema_text(name))
    return 0
