"""sdist → wheel → a clean environment: what a user installs is what the repository holds.

An editable install finds modules and data that a wheel lacks; only building and installing one shows it.
Nothing is fetched: the build uses the setuptools at hand, and the clean environment sees the dependencies of
this one through a path file, but not the project itself.
"""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

from support.benches.rigs import small, small_parts
from support.campaign.sampling import sample
from support.commands.command import PATIENCE_S
from support.commands.repository import EXAMPLES, PACKAGE, ROOT

pytestmark = pytest.mark.slow

LEFT_OUT = {"build", "dist", "__pycache__"}

IMPORT_ALL = """
import importlib, json, sys
failed = {}
for name in json.load(sys.stdin):
    try:
        found = importlib.import_module(name).__file__
        if not found.startswith(sys.prefix):
            failed[name] = "found outside the environment: " + found
    except Exception as error:
        failed[name] = repr(error)
json.dump(failed, sys.stdout)
"""


def run(*command: str | Path, cwd: Path, stdin: str | None = None, **settings: str) -> str:
    """Run a program outside the repository, with an environment in which nothing points back to it."""
    own = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "COV_", "PYTEST"))}
    environment = own | settings
    done = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env=environment,
        input=stdin,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, f"{command} failed:\n{done.stdout}\n{done.stderr}"
    return done.stdout


def source_files() -> list[Path]:
    """Files of the project, relative to its root: what git would hold, or without git what is not made."""
    if (ROOT / ".git").exists() and shutil.which("git"):
        listed = subprocess.run(
            ["git", "ls-files", "-co", "--exclude-standard", "-z"], cwd=ROOT, capture_output=True, check=True
        ).stdout.decode()
        # a file deleted but still listed is gone; a link to a folder is no file
        return sorted(Path(name) for name in set(listed.split("\0")) if name and (ROOT / name).is_file())
    found = []
    for directory, folders, files in os.walk(ROOT):
        folders[:] = [
            f for f in folders if f not in LEFT_OUT and not f.startswith(".") and "egg-info" not in f
        ]
        found += [(Path(directory) / file).relative_to(ROOT) for file in files]
    return sorted(found)


def packaged(suffixes: tuple[str, ...]) -> set[str]:
    """Files of the packages that end so, as POSIX paths below `palpate/`."""
    below = Path("src", "palpate")
    return {
        path.relative_to(below).as_posix()
        for path in source_files()
        if path.is_relative_to(below) and path.name.endswith(suffixes)
    }


def clean_copy(copy: Path) -> Path:
    """Copy the files of the project into a folder; returns it."""
    for path in source_files():
        (copy / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / path, copy / path)
    return copy


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel built from an sdist of a clean copy."""
    work = tmp_path_factory.mktemp("build")
    copy = clean_copy(work / "copy")
    # without --sdist and --wheel, build makes the wheel from the sdist
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", work / "dist", copy, cwd=work)
    (built,) = (work / "dist").glob("*.whl")
    return built


@pytest.fixture(scope="module")
def clean(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A new environment with the wheel installed, and this one's dependencies behind it."""
    root = tmp_path_factory.mktemp("clean") / "env"
    venv.create(root, symlinks=True, with_pip=False)
    site = Path(sysconfig.get_path("purelib", "venv", {"base": str(root), "platbase": str(root)}))
    # a path file adds the folder but does not run the path files inside: an editable install stays behind
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    pip = (sys.executable, "-m", "pip", "--python", root / "bin" / "python", "--disable-pip-version-check")
    run(
        *pip, "install", "--no-deps", "--no-index", "--force-reinstall", "--ignore-installed", wheel, cwd=root
    )
    return root


def test_wheel_holds_every_module_and_every_data_file(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        held = {name.removeprefix("palpate/") for name in archive.namelist() if name.startswith("palpate/")}
    wanted = packaged((".py", ".toml", ".json", ".html", ".css", ".js", "py.typed"))
    assert wanted - held == set()
    (kernel,) = held - wanted
    assert kernel.startswith("recognizer/_kernel.")
    for example in ("config/rigs/bench.toml", "config/objects/memo.json", "config/schemas/rig.schema.json"):
        assert example in held
    assert "py.typed" in held


RECOGNIZE = """
import sys
sys.path.insert(0, "unpacked")
from palpate.cli import main
assert "unpacked" in main.__file__
main.main()
"""


@pytest.mark.parametrize(
    ("kind", "tags", "kernels"),
    sample(
        [("pure", "py3-none-any", []), ("stable", "cp311-abi3-", ["palpate/recognizer/_kernel.abi3.so"])],
        [("pure", "py3-none-any", [])],
    ),
)
def test_wheels_for_an_index_hold_for_many_pythons(
    tmp_path: Path, kind: str, tags: str, kernels: list[str]
) -> None:
    copy = clean_copy(tmp_path / "copy")
    build = (sys.executable, "-m", "build", "--no-isolation", "--wheel", "--outdir", tmp_path, copy)
    run(*build, cwd=tmp_path, PALPATE_WHEEL=kind)
    (built,) = tmp_path.glob(f"palpate-*-{tags}*.whl")
    with zipfile.ZipFile(built) as archive:
        archive.extractall(tmp_path / "unpacked")
        assert [name for name in archive.namelist() if "_kernel" in name] == kernels
    objects = PACKAGE / "config" / "objects" / "memo.json"
    asked = ("recognize", "--objects", objects, "--contacts", EXAMPLES / "contacts.json", "--json")
    found = json.loads(run(sys.executable, "-c", RECOGNIZE, *asked, cwd=tmp_path))
    assert found["hypotheses"]


def test_nothing_lands_at_top_level_but_the_one_root(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        top = {name.partition("/")[0] for name in archive.namelist()}
    (info,) = top - {"palpate"}
    assert info.startswith("palpate-")
    assert info.endswith(".dist-info")


def test_wheel_carries_license_readme_and_requirements(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (metadata,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        content = archive.read(metadata).decode()
        assert any(name.endswith("/LICENSE") for name in archive.namelist())
    assert "License-Expression: Apache-2.0" in content
    assert "Requires-Python: >=3.11" in content
    assert (ROOT / "README.md").read_text(encoding="utf-8").splitlines()[0] in content


def test_every_module_can_be_imported_from_the_wheel(clean: Path) -> None:
    modules = sorted(
        "palpate." + path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        for path in packaged((".py",))
    )
    assert len(modules) > 100
    answer = run(clean / "bin" / "python", "-c", IMPORT_ALL, cwd=clean, stdin=json.dumps(modules))
    assert json.loads(answer) == {}


def test_shipped_files_are_found_from_the_wheel(clean: Path) -> None:
    program = (
        "from palpate.config import *; import palpate.config as c\n"
        "print(c.load_rig(c.shipped_rig()).name, len(c.load_objects(c.shipped_objects()).objects))"
    )
    assert run(clean / "bin" / "python", "-c", program, cwd=clean).split() == ["bench", "6"]


def test_the_schema_of_rig_files_needs_no_plug_in(clean: Path) -> None:
    schema = json.loads(run(clean / "bin" / "palpate", "schema", "rig", cwd=clean))
    array = schema["properties"]["fingers"]["items"]["oneOf"][0]["properties"]["array"]
    assert array["properties"]["protocol"]["examples"] == ["palpate", "present-current", "contact-lines"]
    assert "counts_per_n" not in array["properties"]


def test_console_script_is_installed_and_helps(clean: Path) -> None:
    script = clean / "bin" / "palpate"
    assert script.is_file()
    assert "identify" in run(script, "--help", cwd=clean)


@pytest.fixture(scope="module")
def with_plugin(clean: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the example plug-in, installed beside palpate; returns the copy."""
    copy = tmp_path_factory.mktemp("plugin") / "array_plugin"
    shutil.copytree(EXAMPLES / "array_plugin", copy)
    pip = (sys.executable, "-m", "pip", "--python", clean / "bin" / "python", "--disable-pip-version-check")
    run(*pip, "install", "--no-deps", "--no-index", "--no-build-isolation", copy, cwd=clean)
    return copy


def test_an_installed_plug_in_passes_its_own_tests(clean: Path, with_plugin: Path) -> None:
    tests = with_plugin / "tests"
    said = run(clean / "bin" / "python", "-m", "pytest", "-q", "-p", "no:cacheprovider", tests, cwd=tests)
    assert " passed" in said


def test_an_emulated_rig_with_a_plug_in_is_checked_and_identifies(clean: Path, with_plugin: Path) -> None:
    program = (
        "from pathlib import Path; from palpate.testing import rig_with_arrays\n"
        "print(rig_with_arrays(Path(), 'lines', {'counts_per_n': 2000.0, 'oversampling': 2}, rate_hz=100.0))"
    )
    rig = run(clean / "bin" / "python", "-c", program, cwd=clean).strip()
    quick = small(clean / rig).replace("approach_speed_mm_s = 20.0", "approach_speed_mm_s = 30.0")
    (clean / rig).write_text(quick, encoding="utf-8")
    checked = json.loads(run(clean / "bin" / "palpate", "check", "--rig", rig, "--json", cwd=clean))
    assert {(array["protocol"], array["firmware"]) for array in checked["arrays"]} == {("lines", "lines 1")}
    words = ("--rig", rig, "--objects", small_parts(clean), "--seed", "7", "--json")
    answer = run(clean / "bin" / "palpate", "identify", *words, cwd=clean)
    assert json.loads(answer)["verdict"] == "identified"
