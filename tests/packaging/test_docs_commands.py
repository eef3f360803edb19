"""Every command in the documentation exists; those behind a prompt are run, and print what stands there."""

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from itertools import takewhile
from pathlib import Path
from typing import Any

import pytest
import trimesh
import typer.main

from palpate.cli.main import app
from support.benches.parts import ELL, mesh_file, prism
from support.campaign.sampling import sample
from support.commands.command import PALPATE, PATIENCE_S
from support.commands.pages import PAGES, Shown, differences, mentioned, shown_on
from support.commands.repository import ROOT

pytestmark = [pytest.mark.slow]

SHOWN = [shown for page in PAGES for shown in shown_on(page)]
SESSION = "identify --seed 19"
README = ROOT / "README.md"


def plain_plate(**changes: object) -> dict[str, object]:
    """The page's plate."""
    outline = [[0, 0], [70, 0], [70, 25], [55, 40], [0, 40]]
    return {"name": "plate", "outline": outline, "height": 20.0, **changes}


def catalogue(*parts: dict[str, object]) -> str:
    return json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": parts})


def json_blocks(page: Path) -> list[str]:
    return [part.split("```")[0] for part in page.read_text(encoding="utf-8").split("```json\n")[1:]]


def parts_files(folder: Path) -> None:
    """What adding-an-object.md speaks of."""
    blocks = json_blocks(ROOT / "docs/adding-an-object.md")
    (objects,) = [text for text in blocks if '"standing"' in text]
    (scene,) = [text for text in blocks if "palpate/scene@1" in text]
    standing = json.loads(scene) | {"state": "standing"}
    standing["configuration"]["x"] = 5.0
    crossed = [[0, 0], [70, 0], [55, 40], [70, 25], [0, 40]]
    files = {
        "my-parts.json": objects,
        "my-scene.json": scene,
        "my-standing-scene.json": json.dumps(standing),
        "with-sheet.json": catalogue(plain_plate(), plain_plate(name="sheet", height=6.0)),
        "crossed.json": catalogue(plain_plate(outline=crossed)),
        "others.json": catalogue(plain_plate()),
    }
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    mesh_file(prism(ELL, 20), folder / "angle.stl")
    ran(
        "objects",
        "import",
        "angle.stl",
        "--units",
        "mm",
        "--heights",
        "5",
        "--out",
        "low.objects.json",
        cwd=folder,
    )
    one, two = (trimesh.creation.box((10, 10, 10)) for _ in range(2))
    two.apply_translation((10, 10, 0))
    mesh_file(trimesh.util.concatenate([one, two]), folder / "touching.obj")
    parts = folder / "parts"
    parts.mkdir()
    mesh_file(one, parts / "bad.stl")
    mesh_file(trimesh.creation.icosphere(subdivisions=4, radius=10.0), parts / "ball.3mf")
    mesh_file(trimesh.creation.cone(15.0, 30.0, sections=96), parts / "cone.3mf")
    mesh_file(trimesh.creation.annulus(7.0, 14.0, 2.5, sections=96), parts / "washer.3mf")


def four_parts(folder: Path) -> None:
    """The catalogue that study.md shows."""
    (text,) = json_blocks(ROOT / "docs/study.md")
    (folder / "my-parts.json").write_text(text, encoding="utf-8")


def a_run(folder: Path) -> None:
    ran(*SESSION.split(), cwd=folder)


def files_of_the_source(folder: Path) -> None:
    for name in ("examples", "src"):
        (folder / name).symlink_to(ROOT / name)


PREPARED: dict[str, tuple[Callable[[Path], None], ...]] = {
    "README.md": (files_of_the_source, a_run),
    "adding-an-object.md": (parts_files,),
    "importing.md": (parts_files,),
    "planning.md": (files_of_the_source,),
    "session-log.md": (a_run,),
    "study.md": (four_parts,),
}
HOW_FAR = "runs: "  # begins what a study says on a slow computer


def ran(*words: str, cwd: Path) -> str:
    """What a command prints, as on a narrow screen that is no terminal."""
    done = subprocess.run(
        [PALPATE, *words],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=PATIENCE_S,
        check=False,
        env=os.environ | {"COLUMNS": "96"},
    )
    return "".join(line for line in done.stdout.splitlines(keepends=True) if not line.startswith(HOW_FAR))


def first_line(*words: str, cwd: Path) -> str:
    """What a command that goes on prints first."""
    with subprocess.Popen(
        [PALPATE, *words], cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.communicate(timeout=PATIENCE_S)
        process.kill()
    return line


def is_free(port: int) -> bool:
    with contextlib.closing(socket.socket()) as client:
        return client.connect_ex(("127.0.0.1", port)) != 0


@pytest.mark.parametrize(
    "name",
    sample(
        sorted({shown.page.name for shown in SHOWN}),
        ["benches.md", "emulation.md"],
    ),
)
def test_commands_behind_a_prompt_print_what_stands_beneath(name: str, tmp_path: Path) -> None:
    for prepare in PREPARED.get(name, ()):
        prepare(tmp_path)
    wrong = []
    for shown in [item for item in SHOWN if item.page.name == name]:
        goes_on = "emulate" in shown.words or "--view" in shown.words
        if goes_on and not all(map(is_free, (5000, 5001, 5002, 5003, 8765))):
            continue
        output = (first_line if goes_on else ran)(*shown.words, cwd=tmp_path)
        wrong += [f"{shown}\n  {line}" for line in differences(shown, output)]
    assert not wrong, "\n".join(wrong)


def indented_after(text: str, mark: str) -> list[str]:
    """Lines of the first indented block behind `mark`."""
    lines = iter(text[text.index(mark) :].splitlines()[1:])
    first = next(line for line in lines if line.startswith("    "))
    return [line.removeprefix("    ") for line in (first, *takewhile(lambda item: item.strip(), lines))]


def test_the_demo_prints_what_the_readme_says_and_the_moving_picture_is_of_its_session(
    tmp_path: Path,
) -> None:
    printed = ran(*SESSION.split(), "--picture", "demo.svg", cwd=tmp_path)
    block = indented_after(README.read_text(encoding="utf-8"), "`make demo` ends with:")
    assert len(block) > 5
    shown = Shown(README, 0, tuple(SESSION.split()), ("…", *block))
    assert differences(shown, printed) == []
    (session,) = (tmp_path / "palpate-sessions").iterdir()
    drawn = tmp_path / "run.svg"
    ran("export", str(session), "--animation", str(drawn), cwd=tmp_path)
    picture = (ROOT / "docs/images/run.svg").read_text(encoding="utf-8")
    assert numbers_of(drawn.read_text(encoding="utf-8")) == pytest.approx(numbers_of(picture), abs=0.02)


def test_the_readmes_program_prints_what_stands_beneath(tmp_path: Path) -> None:
    text = README.read_text(encoding="utf-8")
    (program,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=200, check=True
    )
    assert done.stdout.splitlines() == indented_after(text, "print(answer)\n```")


def numbers_of(picture: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", picture)]


def test_files_that_are_named_exist() -> None:
    """Every path of the repository between back quotes, and every test or benchmark by its name."""
    folders = "benchmarks|docs|examples|firmware|plugins|src|tests"
    wrong = []
    for page in [*PAGES, *ROOT.glob("docs/adr/*.md"), ROOT / "CONTRIBUTING.md"]:
        text = page.read_text(encoding="utf-8")
        for name in re.findall(rf"`((?:{folders})/[\w./-]*\w)`", text):
            wrong += [] if (ROOT / name).exists() else [f"{page.name}: {name}"]
        for name in re.findall(r"`((?:test|bench)_\w+\.py)`", text):
            wrong += [] if any(ROOT.glob(f"*/**/{name}")) else [f"{page.name}: {name}"]
    assert wrong == []


def test_a_shell_completes_commands(tmp_path: Path) -> None:
    for typed, offered in (
        ("palpate iden", "identify"),
        ("palpate objects mer", "merge"),
        ("palpate identify --see", "--seed"),
    ):
        asked = {
            "_PALPATE_COMPLETE": "complete_bash",
            "COMP_WORDS": typed,
            "COMP_CWORD": str(len(typed.split()) - 1),
        }
        done = subprocess.run(
            [PALPATE], cwd=tmp_path, env=os.environ | asked, capture_output=True, text=True, check=False
        )
        assert done.stdout.split() == [offered]


def options_of(words: list[str]) -> tuple[list[str], set[str]] | None:
    """The command's words and its options; None if there is no such command."""
    command: Any = typer.main.get_command(app)
    path = []
    for word in words:
        inner_ones = getattr(command, "commands", None)
        if inner_ones is None or word.startswith("-"):
            break
        inner = inner_ones.get(word)
        if inner is None:
            return None
        command = inner
        path.append(word)
    names = {name for item in command.params for name in (*item.opts, *item.secondary_opts)}
    return path, {*names, "--help", "-h"}


def test_every_command_that_is_named_exists_with_its_options() -> None:
    wrong, count = [], 0
    for page in PAGES:
        for number, words in mentioned(page):
            found = options_of(words)
            if found is None:
                wrong.append(f"{page.name}:{number}: palpate {' '.join(words)}")
                continue
            count += 1
            given = {word.split("=")[0] for word in words if word.startswith("--")}
            wrong += [
                f"{page.name}:{number}: {' '.join(found[0])} has no {word}" for word in given - found[1]
            ]
    assert wrong == []
    assert count > 100
