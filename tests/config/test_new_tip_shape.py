"""A fourth shape of tip: one module and one line of registration; what it does not say yet is refused."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import palpate
from support.campaign.sampling import sample

ELLIPSE = '''
from palpate.base.tips.tip import Tip


class Ellipse(Tip):
    """An upright tip that is longer than wide; nothing of it is worked out yet."""

    shape = noun = "ellipse"

    def half_width_mm(self, radius_mm, width_mm):
        return 1.5 * radius_mm

    def plan_mm(self, radius_mm, width_mm):
        return [(radius_mm, 0.0), (0.0, 1.5 * radius_mm), (-radius_mm, 0.0), (0.0, -1.5 * radius_mm)]
'''
REGISTERED = {
    "\n\nclass TipShape": "\nfrom palpate.base.tips.ellipse import Ellipse\n\n\nclass TipShape",
    "    PAD = Pad()\n": "    PAD = Pad()\n    ELLIPSE = Ellipse()\n",
}
FIRM_RIG = Path(__file__).parents[2] / "examples" / "firm-rig.toml"
OBJECTS = "palpate/config/objects/memo.json"
KNOWN = "from palpate.config import load_rig; print(load_rig({rig!r}).fingers[1].tip.shape)"


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A palpate of links to this one, whose tips alone are a copy, with one more."""
    source, folder = Path(palpate.__file__).parent, tmp_path_factory.mktemp("house")
    for room, changed in (("", "base"), ("base", "tips"), ("base/tips", "__init__.py")):
        (folder / "palpate" / room).mkdir()
        for item in (source / room).iterdir():
            if item.name not in (changed, "__pycache__"):
                (folder / "palpate" / room / item.name).symlink_to(item)
    tips = folder / "palpate" / "base" / "tips"
    (tips / "ellipse.py").write_text(ELLIPSE, "utf-8")
    text = (source / "base" / "tips" / "__init__.py").read_text("utf-8")
    for before, after in REGISTERED.items():
        assert text.count(before) == 1
        text = text.replace(before, after)
    (tips / "__init__.py").write_text(text, "utf-8")
    rig = FIRM_RIG.read_text("utf-8")
    (folder / "rig.toml").write_text(with_ellipse(rig), "utf-8")
    return folder


def with_ellipse(rig: str) -> str:
    """The shipped rig, the second finger's tip an ellipse."""
    before, table, after = rig.partition('name = "f2"')
    return before + table + after.replace("[fingers.tip]\n", '[fingers.tip]\nshape = "ellipse"\n', 1)


def run(house: Path, *words: str) -> subprocess.CompletedProcess[str]:
    paths = os.pathsep.join([str(house), *sys.path])
    env = os.environ | {"PYTHONPATH": paths}
    return subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, env=env, cwd=house, check=False
    )


def test_the_rig_file_knows_it(house: Path) -> None:
    assert run(house, "-c", KNOWN.format(rig=str(house / "rig.toml"))).stdout == "ellipse\n"


def test_fingers_keep_clear_of_all_of_its_width(house: Path) -> None:
    wide = "; tip = load_rig({rig!r}).fingers[1].tip; print(tip.half_width_mm / tip.radius_mm)"
    done = run(house, "-c", KNOWN.partition(";")[0] + wide.format(rig=str(house / "rig.toml")))
    assert done.stdout == "1.5\n"


def test_it_is_drawn(house: Path) -> None:
    done = run(house, "-m", "palpate", "check", "--rig", "rig.toml", "--picture", "rig.svg")
    assert done.returncode in (0, 1), done.stderr
    assert "ellipse of radius" in (house / "rig.svg").read_text("utf-8")


@pytest.mark.parametrize(
    "words", sample([["identify"], ["calibrate", "--yes"], ["objects", "check", OBJECTS]], [["identify"]])
)
def test_what_is_not_there_is_refused_in_one_line(house: Path, words: list[str]) -> None:
    done = run(house, "-m", "palpate", *words, "--rig", "rig.toml")
    why = "error: finger f2: its tip is an ellipse, and palpate does not do that with it yet"
    assert (done.returncode, done.stdout, done.stderr.splitlines()) == (2, "", [why])
