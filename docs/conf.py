"""Sphinx configuration of the documentation site: `make docs`."""

import importlib.metadata
import inspect
import os
import re
from pathlib import Path
from typing import Any

import palpate

_DOCS = Path(__file__).parent
_LINK = re.compile(r"\[([^\]]*)\]\(([^)\s#]+)(#[^)\s]*)?\)")

project = "palpate"
author = "The palpate developers"
version = release = importlib.metadata.version("palpate")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns: list[str] = []
html_theme = "furo"
html_title = f"palpate {release}"
myst_heading_anchors = 4
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "description"
napoleon_use_rtype = False
napoleon_custom_sections = [("Interfaces", "params_style")]
nitpicky = False
suppress_warnings = ["myst.header"]  # pages begin with their title, records with their number


def _inside(link: re.Match[str], page: Path) -> str:
    """A link to a file that is no page of the site, such as an example, as the name alone."""
    words, target = link[1], link[2]
    if "://" in target or target.startswith("mailto:"):
        return link[0]
    path = Path(os.path.normpath(page.parent / target))
    if path.is_relative_to(_DOCS) and path.suffix in (".md", ".svg", ".png", ".txt"):
        return link[0]
    return words


def _plain_links(app: Any, name: str, source: list[str]) -> None:
    page = Path(app.env.doc2path(name))
    source[0] = _LINK.sub(lambda link: _inside(link, page), source[0])


def _reference() -> str:
    """The page of the public face: every name that `import palpate` offers."""
    parts = [
        "# Python reference\n",
        "Everything that `import palpate` offers; [python.md](python.md) says how it goes together.\n",
    ]
    for name in sorted(palpate.__all__):
        thing = getattr(palpate, name)
        if inspect.isclass(thing):
            kind, options = "autoclass", "\n   :members:\n"
        elif callable(thing):
            kind, options = "autofunction", "\n"
        else:
            continue
        parts.append(f"```{{eval-rst}}\n.. {kind}:: palpate.{name}{options}```\n")
    return "\n".join(parts)


def setup(app: Any) -> None:
    """Sphinx calls this."""
    (_DOCS / "reference.md").write_text(_reference(), encoding="utf-8")
    app.connect("source-read", _plain_links)
