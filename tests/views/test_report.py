"""The report of a run: one well-formed page that needs nothing else and says what the log says."""

import json
import re
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import pytest
from command import Ended, log_events, log_lines, run_here, write_log
from recorded_run import two_grips
from report_page import Page

Here = Callable[..., Ended]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return two_grips(tmp_path_factory.mktemp("run"))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Here:
    monkeypatch.chdir(tmp_path)
    return lambda *args: run_here(list(args), monkeypatch, capsys)


def report_of(here: Here, session: Path) -> tuple[str, Page]:
    ended = here("report", session, "--out", "report.html")
    assert (ended.code, ended.err, ended.out) == (0, "", "report.html\n")
    text = Path("report.html").read_text(encoding="utf-8")
    return text, Page(text)


def says_what_the_log_says(session: Path, text: str, page: Page) -> None:
    events = log_events(session / "session.jsonl.zst")
    (result,) = [event["result"] for event in events if event["event"] == "result"]
    assert page.headings[0].startswith(f"{result['verdict'].capitalize()}: {result['object']}")
    grips = [event["grip"] for event in events if event["event"] == "touches"]
    assert [name for name in page.headings if name.startswith("Grip")] == [f"Grip {n}" for n in grips]
    words = "\n".join(page.words)
    for name, value in result["configuration"].items():
        assert name == "theta" or f"{value:.3f} mm" in words
    for event in events:
        for touch in event.get("touches", ()):
            assert f"{touch['contact']['end_mm'][0]:.2f}" in words
    models = {event["object"] for event in events if event["event"] == "truth"}
    assert models <= set(re.split(r"[, ;:\n]", words))
    assert len(re.findall("<svg ", text)) == 1 + len(grips)


def has_a_row_for_every_state_that_is_not_left(session: Path, page: Page) -> None:
    events = log_events(session / "session.jsonl.zst")
    last = [event for event in events if event["event"] == "recognised"][-1]
    left = {f"{item['object']}, {item['state']}" for item in last["hypotheses"]}
    import palpate

    states = {
        f"{model.name}, {state.name}"
        for model in palpate.load_objects(session / "objects.json").objects
        for state in model.states
    }
    begin = page.words.index("Why each rival fell")
    rows = set(page.words[begin : page.words.index("Timing")])
    assert states - left <= rows
    assert not left & rows


def asks_nothing_of_elsewhere(text: str, page: Page) -> None:
    assert "default-src 'none'" in text
    assert page.addresses == []
    assert "url(" not in text.replace("url(#", "")
    assert "@import" not in text
    for svg in re.findall(r"<svg .*?</svg>", text, re.DOTALL):
        ET.fromstring(svg)


def has_ids_that_differ(text: str) -> None:
    ids = re.findall(r' id="([^"]+)"', text)
    assert len(ids) == len(set(ids))


def test_the_report_of_a_whole_run(session: Path, here: Here) -> None:
    text, page = report_of(here, session)
    says_what_the_log_says(session, text, page)
    has_a_row_for_every_state_that_is_not_left(session, page)
    asks_nothing_of_elsewhere(text, page)
    has_ids_that_differ(text)


def test_a_run_that_was_killed_is_reported_as_far_as_it_went(
    session: Path, tmp_path: Path, here: Here
) -> None:
    folder = tmp_path / "cut"
    shutil.copytree(session, folder)
    (folder / "picture.svg").unlink()
    lines = log_lines(session / "session.jsonl.zst")
    (end,) = [k for k, line in enumerate(lines) if '"event":"touches","grip":2' in line]
    write_log(folder / "session.jsonl.zst", lines[:end])
    _, page = report_of(here, folder)
    assert page.headings[0].startswith("No answer")
    assert "ended    killed" in "\n".join(page.words)
    assert "Grip 2" in page.headings


def test_names_are_text(session: Path, tmp_path: Path, here: Here) -> None:
    """An object may be called anything printable."""
    folder = tmp_path / "odd"
    shutil.copytree(session, folder)
    (folder / "picture.svg").unlink()
    odd = "<script>alert(1)</script>&amp;"
    objects = (folder / "objects.json").read_text()
    name = next(event for event in log_events(folder / "session.jsonl.zst") if event["event"] == "truth")
    old = f'"{name["object"]}"'
    assert old in objects
    (folder / "objects.json").write_text(objects.replace(old, f'"{odd}"'))
    lines = log_lines(session / "session.jsonl.zst")
    write_log(folder / "session.jsonl.zst", [line.replace(old, f'"{odd}"') for line in lines])
    text, page = report_of(here, folder)
    assert "<script" not in text
    assert any(odd in word for word in page.words)


def test_a_catalogue_is_reported_with_every_pair_and_every_state(here: Here, tmp_path: Path) -> None:
    outline = [[0, 0], [60, 0], [60, 20], [22, 20], [22, 45], [0, 45]]
    parts = [
        {"name": name, "height": 20.0, "outline": outline, "tolerance": tolerance}
        for name, tolerance in (("ell", 0.1), ("<b>ell & again</b>", 0.2))
    ]
    parts.append({"name": "wedge", "height": 20.0, "outline": [[0, 0], [58, 8], [20, 47]]})
    Path("parts.json").write_text(
        json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": parts})
    )
    done = here("objects", "check", "parts.json", "--report", "page.html", "--json")
    assert done.code == 1
    page = Page(Path("page.html").read_text(encoding="utf-8"))
    assert page.addresses == []
    assert page.headings == [
        "1 pair of states can never be distinguished",
        "Result",
        "Never distinguished",
        "States",
        "Sections",
        "Rig",
        "Versions",
    ]
    (pair,) = json.loads(done.out)["pairs"]
    assert {f"{pair[key]['object']}, flat" for key in ("first", "second")} <= set(page.words)
    assert page.words.count("wedge") >= 2, "in the table and on its card"
    done = here("objects", "check", "parts.json", "--report", "nowhere/page.html")
    assert (done.code, done.err.count("\n")) == (2, 1)
