"""`palpate recognize`: from a file of contacts to hypotheses, without a rig."""

from pathlib import Path
from typing import Annotated

import typer

from palpate.base.vocabulary import DEFAULT_BUDGET, LEAST_BUDGET, RecognitionVerdict
from palpate.cli.options import ContactsOption, JsonOption, PictureOption

__all__ = ["recognize"]


def recognize(
    objects: Annotated[Path, typer.Option("--objects", help="Object models (JSON).")],
    contacts: ContactsOption,
    json: JsonOption = False,
    picture: PictureOption = None,
    max_spurious: Annotated[
        int, typer.Option("--max-spurious", min=0, help="As many contacts need not be the object's.")
    ] = 0,
    budget: Annotated[
        int, typer.Option("--budget", min=LEAST_BUDGET, help="Units of work: more give narrower bounds.")
    ] = DEFAULT_BUDGET,
    why: Annotated[
        str | None,
        typer.Option("--why", metavar="OBJECT[/STATE]", help="Also say why this object was ruled out."),
    ] = None,
    statistics: Annotated[
        bool, typer.Option("--statistics", help="Also count interpretations as the memo's tables do.")
    ] = False,
) -> int:
    """Say which objects, states and configurations agree with a file of contacts."""
    from palpate.base.files.writing import check_places, write_text
    from palpate.cli.terminal import Doing, Terminal
    from palpate.jobs.recognition import recognise
    from palpate.recognizer.memo_statistics import memo_counts
    from palpate.views.recognition_text import recognition_lines

    check_places({"--picture": picture}, {"--objects": objects, "--contacts": contacts})
    with Doing(Terminal(stderr=True, soft_wrap=True), "reading") as doing:
        answer = recognise(objects, contacts, max_spurious=max_spurious, budget=budget, progress=doing.now)
    because = None if why is None else answer.why(why)
    memo = memo_counts(answer.catalogue, answer.contacts.contacts) if statistics else None
    if picture is not None:
        write_text(picture, answer.picture())
    if json:
        typer.echo(answer.to_json(because, memo))
    else:
        for line in recognition_lines(
            answer.recognition, answer.contacts, answer.explanation(), because, memo, answer.seconds
        ):
            typer.echo(line)
    return 0 if answer.verdict is RecognitionVerdict.UNIQUE else 1
