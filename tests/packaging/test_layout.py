"""The repository's layout keeps the promises that packaging and static checks rest on."""

import ast
import os
import re
from functools import cache
from pathlib import Path

import pytest
from repository import ROOT

FOLDERS = tuple(sorted(path.name for path in (ROOT / "src" / "palpate").iterdir() if path.is_symlink()))
MODULES = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
MODULES += sorted((ROOT / "src" / "palpate").glob("*.py"))
OUTSIDE = sorted(
    path
    for folder in ("tests", "examples", "benchmarks", "firmware")
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
            bare = sorted(roots & set(FOLDERS))
            wrong += [f"{name_of(path)}:{node.lineno}: import palpate.{root} instead" for root in bare]
    assert wrong == []


def test_modules_say_what_they_are_for() -> None:
    assert [name_of(path) for path in MODULES if not ast.get_docstring(tree_of(path))] == []


def test_only_the_command_line_prints_or_asks() -> None:
    wrong = []
    for path in (path for path in MODULES if not path.is_relative_to(ROOT / "cli")):
        calls = [node for node in ast.walk(tree_of(path)) if isinstance(node, ast.Call)]
        named = {call.func.id for call in calls if isinstance(call.func, ast.Name)}
        wrong += [name_of(path)] if named & {"print", "input"} else []
    assert wrong == []


def test_every_package_folder_is_a_package() -> None:
    assert all((path.parent / "__init__.py").is_file() for path in MODULES)


def test_a_checkout_does_not_shadow_an_installed_palpate() -> None:
    assert not (ROOT / "palpate").exists()


@pytest.mark.parametrize("folder", FOLDERS)
def test_the_import_root_links_to_the_folders_at_the_top(folder: str) -> None:
    link = ROOT / "src" / "palpate" / folder
    assert not link.readlink().is_absolute()
    assert link.resolve() == ROOT / folder


def test_every_folder_at_the_top_that_holds_a_package_is_linked() -> None:
    assert {path.parent.name for path in ROOT.glob("*/__init__.py")} == set(FOLDERS)


def test_no_file_names_a_path_of_one_machine() -> None:
    found = []
    for path in own_files():
        text = path.read_text(encoding="utf-8", errors="replace")
        found += [f"{name_of(path)}: {match.group()}" for match in MACHINE_PATH.finditer(text)]
    assert not found
