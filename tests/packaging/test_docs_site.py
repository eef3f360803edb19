"""The documentation site is built without a warning, and has every page and every public name."""

import subprocess
import sys
from pathlib import Path

import pytest
from repository import ROOT

import palpate

pytestmark = [pytest.mark.slow, pytest.mark.timeout(200)]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    words = ["--fail-on-warning", "--keep-going", "--quiet", "--builder", "html", "docs", folder]
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", *words], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    return folder


def test_every_page_is_in_the_site(site: Path) -> None:
    pages = {path.relative_to(ROOT / "docs").with_suffix(".html") for path in ROOT.glob("docs/**/*.md")}
    assert pages <= {path.relative_to(site) for path in site.glob("**/*.html")}
    index = (site / "index.html").read_text(encoding="utf-8")
    for page in pages:
        assert page.as_posix() in index or page.stem in ("index",), f"{page} is in no list of pages"


def test_every_public_name_has_its_entry(site: Path) -> None:
    reference = (site / "reference.html").read_text(encoding="utf-8")
    named = [name for name in palpate.__all__ if callable(getattr(palpate, name))]
    assert [name for name in named if f'id="palpate.{name}"' not in reference] == []


def test_pages_ask_nothing_of_elsewhere(site: Path) -> None:
    for path in site.glob("**/*.html"):
        text = path.read_text(encoding="utf-8")
        assert 'src="http' not in text
        assert '<link rel="stylesheet" type="text/css" href="http' not in text
