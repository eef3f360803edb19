"""Sphinx configuration of the documentation site: `make docs`."""

import importlib.metadata
import inspect
import os
import re
from pathlib import Path
from typing import Any

from packaging.version import Version

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
templates_path = ["_templates"]
html_sidebars = {
    "**": [
        *(
            "sidebar/brand.html",
            "sidebar/search.html",
            "sidebar/scroll-start.html",
            "sidebar/navigation.html",
        ),
        *("versions.html", "sidebar/scroll-end.html"),
    ]
}
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


def _list_versions(app: Any, problem: Exception | None) -> None:
    """Begin the site with the newest of the versions whose folders lie there, and a list of all."""
    site = Path(app.outdir).parent
    found = sorted((page.parent.name for page in site.glob("[0-9]*/index.html")), key=Version, reverse=True)
    if problem is not None or not found:
        return
    # A version that is being made is not where readers should begin, unless there is no other.
    newest = next((name for name in found if not Version(name).is_prerelease), found[0])
    links = "".join(f'<li><a href="{name}/index.html">palpate {name}</a></li>' for name in found)
    style = (
        "<style>:root{color-scheme:light dark}"
        "body{font:1rem/1.6 sans-serif;max-width:40em;margin:4em auto}</style>"
    )
    head = f'<meta charset="utf-8"><title>palpate</title>{style}<h1>palpate {newest}</h1>'
    text = f'<p><a href="{newest}/index.html">Read its documentation</a>, or that of another version:</p>'
    (site / "index.html").write_text(f"<!doctype html>{head}{text}<ul>{links}</ul>", encoding="utf-8")


def setup(app: Any) -> None:
    """Sphinx calls this."""
    (_DOCS / "reference.md").write_text(_reference(), encoding="utf-8")
    app.connect("source-read", _plain_links)
    app.connect("build-finished", _list_versions)
