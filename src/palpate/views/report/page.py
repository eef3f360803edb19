"""One self-contained HTML page: headings, tables, text as it stands, SVG pictures; fit for printing on A4."""

import math
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from html import escape

_STYLE = """
:root { color-scheme: light dark; --ink: #1d2b36; --paper: #fff; --muted: #5b6b78; --line: #d5dde3; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4eaef; --paper: #14191e; --muted: #9fb0bd; --line: #33404b; }
}
* { box-sizing: border-box; }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); margin: 0 auto;
  max-width: 68rem; padding: 1.5rem; }
h1 { font-size: 1.7rem; line-height: 1.25; margin: 0 0 .3rem; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 .6rem; border-bottom: 1px solid var(--line); padding-bottom: .2rem; }
h3 { font-size: 1rem; margin: 1.4rem 0 .4rem; }
p { margin: .4rem 0; } ul { padding-left: 1.2rem; } .muted { color: var(--muted); }
table { border-collapse: collapse; width: 100%; font-size: .92rem; margin: .5rem 0; }
th, td { text-align: left; padding: .25rem .6rem .25rem 0; border-bottom: 1px solid var(--line);
  vertical-align: top; overflow-wrap: break-word; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
pre { background: color-mix(in srgb, var(--ink) 6%, transparent); padding: .7rem .9rem; border-radius: .4rem;
  overflow-x: auto; font-size: .86rem; white-space: pre-wrap; overflow-wrap: anywhere; }
figure { margin: .6rem 0; background: #fff; border: 1px solid var(--line); border-radius: .4rem;
  padding: .3rem; }
figure svg, figure img { display: block; width: 100%; height: auto; max-height: 40rem; }
.sections figure svg, figure img { max-height: none; }
.matrix { width: auto; }
.matrix td, .matrix thead th { text-align: center; min-width: 2.2rem; }
.columns { display: grid; gap: 0 2rem;
  grid-template-columns: repeat(auto-fit, minmax(min(30rem, 100%), 1fr)); }
@media print {
  @page { size: A4; margin: 15mm; }
  :root { --ink: #000; --paper: #fff; --muted: #444; --line: #bbb; }
  body { max-width: none; padding: 0; font-size: 10pt; }
  h2 { break-after: avoid; margin: 5mm 0 2mm; } figure, tr, .grip { break-inside: avoid; }
  figure svg { max-height: 68mm; } .sections figure svg { max-height: 240mm; }
  .columns { display: block; } pre { font-size: 7.5pt; }
  .settings pre { column-count: 2; background: none; border: 1px solid var(--line); }
}
"""


def page(title: str, parts: Iterable[str]) -> str:
    """The document. Nothing in it comes from elsewhere: a policy forbids scripts and any request."""
    policy = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body>\n</html>\n"
    )


def heading(title: str, subtitle: str) -> str:
    """The page's title."""
    return f'<h1>{escape(title)}</h1>\n<p class="muted">{escape(subtitle)}</p>'


def section(title: str, *parts: str, kind: str = "") -> str:
    """A part of the page with a title."""
    inner = "\n".join((f"<h2>{escape(title)}</h2>", *parts))
    return f'<section class="{kind}">\n{inner}\n</section>'


def subheading(title: str) -> str:
    """A title within a section."""
    return f"<h3>{escape(title)}</h3>"


def paragraph(text: str) -> str:
    """A paragraph."""
    return f"<p>{escape(text)}</p>"


def lines(text: str) -> str:
    """Text as it stands."""
    return f"<pre>{escape(text)}</pre>"


def bullets(items: Iterable[str]) -> str:
    """A list of sentences."""
    return f"<ul>{''.join(f'<li>{escape(item)}</li>' for item in items)}</ul>"


def picture(svg: str) -> str:
    """A picture: an SVG document made by palpate."""
    return f"<figure>{svg.strip()}</figure>"


def embedded_picture(words: str, svg: str) -> str:
    """A picture whose ids stay apart from those of other pictures; `words` for those who do not see it."""
    data = b64encode(svg.encode()).decode()
    return f'<figure><img alt="{escape(words)}" src="data:image/svg+xml;base64,{data}"/></figure>'


def columns(*parts: str) -> str:
    """Parts side by side where there is room."""
    return '<div class="columns">' + "".join(f"<div>{part}</div>" for part in parts) + "</div>"


def table(names: Sequence[str], rows: Iterable[Sequence[str]], numbers: Sequence[str] = ()) -> str:
    """A table; columns in `numbers` are aligned right. Without names: rows of name and value."""
    kinds = [' class="n"' if name in numbers else "" for name in names]
    head = "".join(f"<th{kind}>{escape(name)}</th>" for name, kind in zip(names, kinds, strict=True))
    body = "".join(f"<tr>{_cells(row, kinds)}</tr>" for row in rows)
    return f"<table>{f'<thead><tr>{head}</tr></thead>' if any(names) else ''}<tbody>{body}</tbody></table>"


def _cells(row: Sequence[str], kinds: Sequence[str]) -> str:
    return "".join(f"<td{kind}>{escape(cell)}</td>" for cell, kind in zip(row, kinds, strict=True))


def matrix(names: Sequence[str], shares: Mapping[tuple[str, str], float]) -> str:
    """A table of percentages: a row and a numbered column for each name, larger shares with more colour."""
    head = "".join(f"<th>{number}</th>" for number in range(1, len(names) + 1))
    body = ""
    for number, row in enumerate(names, start=1):
        cells = "".join(_share_cell(shares.get((row, name), 0.0)) for name in names)
        body += f"<tr><th>{number} {escape(row)}</th>{cells}</tr>"
    return f'<table class="matrix"><thead><tr><th></th>{head}</tr></thead><tbody>{body}</tbody></table>'


def _share_cell(share: float) -> str:
    if not share:
        return "<td></td>"
    return f'<td style="background: rgb(213 94 0 / {math.sqrt(share):.2f})">{100 * share:.0f}</td>'
