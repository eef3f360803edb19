"""The repository's layout keeps the promises that packaging and static checks rest on."""

import ast
import os
import re
from functools import cache
from pathlib import Path

import pytest
from repository import PACKAGE, ROOT

FOLDERS = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
SIGNPOSTS = ("calibration", "config", "drivers", "recognizer")
MODULES = sorted([*PACKAGE.rglob("*.py"), *ROOT.glob("plugins/*/src/**/*.py")])
OUTSIDE = sorted(
    path
    for folder in ("tests", "examples", "benchmarks", "firmware", "plugins")
    for path in (ROOT / folder).rglob("*.py")
)
TEXTS = {".py", ".toml", ".json", ".md", ".txt", ".yml", ".yaml", ".svg", ".ino", ".c", ".h", ""}
SKIPPED = {"build", "dist", "__pycache__"}
MACHINE_PATH = re.compile(r"(?<![\w.$}])/(?:home|root|Users|work|mnt|workspace)/[\w.-]")


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


def own_files() -> list[Path]:
    """Text files of the project below the root, leaving out what is made, hidden or another checkout's."""
    found = []
    for directory, folders, files in os.walk(ROOT):
        folders[:] = [
            f
            for f in folders
            if f not in SKIPPED
            and not f.endswith(".egg-info")
            and (not f.startswith(".") or f == ".ci")
            and not f.startswith("palpate-sessions")
        ]
        found += [Path(directory) / file for file in files if Path(file).suffix in TEXTS]
    return [path for path in found if not path.is_symlink()]


def test_imports_go_through_the_one_root() -> None:
    wrong = []
    for path in MODULES + OUTSIDE:
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.ImportFrom):
                if node.level:
                    wrong.append(f"{name_of(path)}:{node.lineno}: relative import")
                roots = {(node.module or "").partition(".")[0]}
            elif isinstance(node, ast.Import):
                roots = {alias.name.partition(".")[0] for alias in node.names}
            else:
                continue
            bare = sorted(roots & FOLDERS)
            wrong += [f"{name_of(path)}:{node.lineno}: import palpate.{root} instead" for root in bare]
    assert wrong == []


def test_modules_say_what_they_are_for() -> None:
    assert [name_of(path) for path in MODULES if not ast.get_docstring(tree_of(path))] == []


def test_only_the_command_line_prints_or_asks() -> None:
    wrong = []
    for path in (path for path in MODULES if not path.is_relative_to(PACKAGE / "cli")):
        calls = [node for node in ast.walk(tree_of(path)) if isinstance(node, ast.Call)]
        named = {call.func.id for call in calls if isinstance(call.func, ast.Name)}
        wrong += [name_of(path)] if named & {"print", "input"} else []
    assert wrong == []


def test_every_package_folder_is_a_package() -> None:
    assert all((path.parent / "__init__.py").is_file() for path in MODULES)


def test_a_checkout_does_not_shadow_an_installed_palpate() -> None:
    assert not (ROOT / "palpate").exists()


@pytest.mark.parametrize("name", SIGNPOSTS)
def test_signposts_point_into_the_package(name: str) -> None:
    """Where links cannot be made, git leaves a file that holds the link's text."""
    signpost = ROOT / name
    target = signpost.readlink().as_posix() if signpost.is_symlink() else signpost.read_text(encoding="utf-8")
    assert target == f"src/palpate/{name}"


def test_no_file_names_a_path_of_one_machine() -> None:
    found = []
    for path in own_files():
        text = path.read_text(encoding="utf-8", errors="replace")
        found += [f"{name_of(path)}: {match.group()}" for match in MACHINE_PATH.finditer(text)]
    assert not found
