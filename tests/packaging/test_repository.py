"""The repository: layout, guarded motion, safety page, site of the documentation."""

import ast
import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import palpate
from support.commands.repository import PACKAGE, ROOT

# ----------------------------------------------------------------------------------------------------
# The repository's layout keeps the promises that packaging and static checks rest on.

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
        found += [Path(directory) / file for file in files if Path(file).suffix in TEXTS and file != ".git"]
    return [path for path in found if not path.is_symlink()]


def test_imports_go_through_the_one_root() -> None:
    wrong = []
    roots_named = "|".join(sorted(FOLDERS))
    suspect = re.compile(rf"\bfrom\s*\.|\b(?:from|import)\b.*(?<![.\w])(?:{roots_named})\b")
    for path in MODULES + OUTSIDE:
        if not suspect.search(path.read_text(encoding="utf-8")):
            continue  # to parse all of them takes long
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


def test_environment_and_robot_are_built_on_the_front_door() -> None:
    folders = [ROOT / "plugins" / name for name in ("gymnasium", "lerobot")]
    for path in [path for folder in folders for path in folder.glob("src/**/*.py")]:
        nodes = [node for node in ast.walk(tree_of(path)) if isinstance(node, ast.Import | ast.ImportFrom)]
        names = [item.name for node in nodes for item in node.names] + [
            getattr(node, "module", "") for node in nodes
        ]
        assert not [name for name in names if (name or "").startswith("palpate.")], name_of(path)


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


# ----------------------------------------------------------------------------------------------------
# Nothing moves, and no time passes while something may move, but through the guarded loop.


def calls(folder: str) -> list[tuple[str, str]]:
    """(file, name of what is called) of every call below a folder."""
    found = []
    for file in sorted((PACKAGE / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                name = (
                    node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                )
                found.append((f"{folder}/{file.relative_to(PACKAGE / folder)}", name))
    return found


def test_goals_are_written_by_the_guarded_loop_alone() -> None:
    writers = {"write_goals", "stop_at"}
    everywhere = [*calls("cli"), *calls("jobs"), *calls("rig"), *calls("calibration"), *calls("drivers")]
    assert {file for file, name in everywhere if name in writers} == {"drivers/dynamixel/guarded_motion.py"}


def test_a_connected_rig_lets_time_pass_in_one_place() -> None:
    """`Hand.pause` looks at arrays; what waits without a hand moves nothing."""
    sleepers = {file for file, name in [*calls("cli"), *calls("jobs"), *calls("rig")] if name == "sleep"}
    without_hand = {
        "rig/diagnostics/host_ports.py",
        "jobs/monitor.py",
        "rig/diagnostics/array_examination.py",
        "rig/array_monitor.py",
        "rig/diagnostics/wiring_check.py",
        "rig/diagnostics/servo_bus.py",  # a servo that restarts
        "rig/motion/servo_causes.py",  # one that has restarted, with torque off
        "rig/motion/dead_man.py",  # a process of its own
    }
    waits_for_lost_devices = (
        "rig/motion/array_guard.py"  # an adapter that is gone, an array after fingers stopped
    )
    assert sleepers == {"rig/motion/hand.py", waits_for_lost_devices, *without_hand}
    assert "sleep" not in {name for _, name in calls("calibration")}


def test_no_wall_clock_decides_anything() -> None:
    """A clock that is set changes dates of files, and nothing else."""
    readers = [
        file
        for folder in ("drivers", "calibration", "recognizer")
        for file, name in calls(folder)
        if name in ("time", "time_ns", "utcnow", "today")
    ]
    assert readers == []


# ----------------------------------------------------------------------------------------------------
# Every row of the safety page's second table is a test, by its name; the first table is the fault matrix.


def rows() -> list[list[str]]:
    """Cells of the table's rows."""
    page = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
    table = page[page.index("| fault | what the stack does | what the operator sees | test |") :]
    lines = table[: table.index("\n\n")].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def functions_named(names: set[str]) -> dict[str, ast.FunctionDef]:
    """Test functions by these names."""
    found = {}
    for file in sorted((ROOT / "tests").rglob("test_*.py")):
        text = file.read_text(encoding="utf-8")
        if names.isdisjoint(re.findall(r"(?m)^def (test_\w+)", text)):
            continue  # to parse all of them takes long
        for node in ast.parse(text).body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                found[node.name] = node
    return found


def test_every_row_names_a_test_that_exists_and_asserts_something() -> None:
    table = rows()
    known = functions_named({test.strip("`") for *_, test in table})
    assert len(table) >= 10
    for fault, does, sees, test in table:
        assert all((fault, does, sees)), fault
        match = re.fullmatch(r"`(test_\w+)`", test)
        assert match is not None, f"{fault}: no test is named"
        assert match[1] in known, f"{fault}: there is no {match[1]}"
        body = ast.unparse(known[match[1]])
        assert "assert" in body or "pytest.raises" in body, match[1]


def test_no_test_stands_for_two_rows() -> None:
    names = [row[3] for row in rows()]
    assert len(names) == len(set(names))


# ----------------------------------------------------------------------------------------------------
# The documentation site is built without a warning, and has every page and every public name.


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    words = ["--fail-on-warning", "--keep-going", "--quiet", "--builder", "html", "docs", folder]
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", *words], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    return folder


@pytest.mark.slow
def test_every_page_is_in_the_site(site: Path) -> None:
    pages = {path.relative_to(ROOT / "docs").with_suffix(".html") for path in ROOT.glob("docs/**/*.md")}
    assert pages <= {path.relative_to(site) for path in site.glob("**/*.html")}
    index = (site / "index.html").read_text(encoding="utf-8")
    for page in pages:
        assert page.as_posix() in index or page.stem in ("index",), f"{page} is in no list of pages"


@pytest.mark.slow
def test_every_public_name_has_its_entry(site: Path) -> None:
    reference = (site / "reference.html").read_text(encoding="utf-8")
    named = [name for name in palpate.__all__ if callable(getattr(palpate, name))]
    assert [name for name in named if f'id="palpate.{name}"' not in reference] == []


@pytest.mark.slow
def test_pages_ask_nothing_of_elsewhere(site: Path) -> None:
    for path in site.glob("**/*.html"):
        text = path.read_text(encoding="utf-8")
        assert 'src="http' not in text
        assert '<link rel="stylesheet" type="text/css" href="http' not in text
