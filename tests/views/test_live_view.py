"""The live view: a page on this computer only, of a recorded session and of a run; its stop button stops."""

import http.client
import json
import re
import shutil
import signal
import socket
import subprocess
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import dynamixel_sdk
import pytest

from palpate.config.recognition_results import IdentificationOut
from palpate.testing import served
from palpate.views.answer import headline
from support.benches.rigs import firm_rig, quick_bench, slow_rig
from support.commands.command import (
    PALPATE,
    PATIENCE_S,
    Started,
    bytes_sent,
    log_events,
    log_lines,
    started,
    torque_writes,
    until,
    write_log,
)

CHROMIUM = shutil.which("chromium")
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None or shutil.which("chromedriver") is None, reason="no chromium or no chromedriver here"
)


def free_port() -> int:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        port: int = server.getsockname()[1]
        return port


class Page:
    """What a browser, or another program, gets of a view."""

    def __init__(self, port: int) -> None:
        self.port = port

    def ask(self, path: str, method: str = "GET", **headers: str) -> tuple[int, str, dict[str, str]]:
        with closing(http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)) as connection:
            named = {name.replace("_", "-"): value for name, value in headers.items()}
            connection.request(method, path, headers=named)
            answer = connection.getresponse()
            return answer.status, answer.read().decode(), dict(answer.getheaders())

    def json(self, path: str) -> Any:
        status, text, _ = self.ask(path)
        assert status == 200, text
        return json.loads(text)

    @property
    def token(self) -> str:
        found = re.search('name="palpate-token" content="([^"]+)"', self.ask("/")[1])
        assert found is not None
        return found[1]


@contextmanager
def page_of(*words: object, cwd: Path) -> Iterator[tuple[Started, Page]]:
    """A command that serves a view, `words` up to the number of its port, and the page."""
    port = free_port()
    with started(*words, port, cwd=cwd) as command:
        command.until(lambda: is_served(port))
        yield command, Page(port)


@contextmanager
def viewed(session: Path) -> Iterator[Page]:
    with page_of("view", session, "--port", cwd=session) as (_, page):
        until(lambda: page.json("/extent")["ended"])
        yield page


@pytest.fixture(scope="module")
def session(recorded: Callable[[str], Path]) -> Path:
    return recorded("two grips")


@pytest.fixture(scope="module")
def page(session: Path) -> Iterator[Page]:
    with viewed(session) as found:
        yield found


def test_frames_say_what_the_log_says(session: Path, page: Page) -> None:
    events = log_events(session / "session.jsonl.zst")
    extent = page.json("/extent")
    assert extent["last"] == pytest.approx(events[-1]["t_s"], abs=1e-4)
    last = page.json(f"/frame?t={extent['last']}")
    (result,) = [event["result"] for event in events if event["event"] == "result"]
    assert (last["verdict"], last["end"]["how"]) == (result["verdict"], "done")
    (part,) = last["parts"]
    shown = part["hypotheses"][0]
    assert {name: shown[name] for name in ("x", "y", "theta")} == result["configuration"]
    assert list(shown["bounds"].values()) == [list(pair) for pair in result["bounds"].values()]
    assert (part["left"], last["plan"]) == (1 + len(result["alternatives"]), [])
    touches = [touch for event in events for touch in event.get("touches", ())]
    assert [item["end"] for item in last["contacts"]] == [touch["contact"]["end_mm"] for touch in touches]
    for event in events:
        if event["event"] == "stage":
            frame = page.json(f"/frame?t={event['t_s'] + 0.001}")
            assert (frame["grip"], frame["stage"]) == (event["grip"], event["stage"])
    first = next(event for event in events if event["event"] == "touches")
    before = page.json(f"/frame?t={first['t_s'] - 0.1}")
    assert before["contacts"] == []
    assert set(before["tips"]) == {"f1", "f2", "f3"}
    assert max(array["most"] for array in before["arrays"].values()) >= 0


def test_the_stream_of_a_recorded_session_ends(page: Page) -> None:
    status, text, headers = page.ask("/stream")
    assert (status, headers["content-type"].split(";")[0]) == (200, "text/event-stream")
    assert "event: end" in text
    assert json.loads(text.split("data: ", 1)[1].split("\n", 1)[0])["end"]["how"] == "done"


def test_the_page_may_load_nothing_from_elsewhere(page: Page) -> None:
    for path in ("/", "/page.js", "/page.css"):
        status, text, headers = page.ask(path)
        assert status == 200
        assert "default-src 'none'" in headers["content-security-policy"]
        addresses = re.findall(r"https?://[^\s\"']+", text)
        assert set(addresses) <= {"http://www.w3.org/2000/svg"}


@pytest.mark.parametrize("path", ["/", "/frame?t=1", "/setting", "/stream", "/page.js"])
def test_other_hosts_and_other_sites_are_refused(page: Page, path: str) -> None:
    assert page.ask(path, Host="evil.example")[0] == 403
    assert page.ask(path, Host=f"evil.example:{page.port}")[0] == 403
    assert page.ask(path, Origin="http://evil.example")[0] == 403
    assert page.ask(path, Origin="null")[0] == 403
    assert page.ask(path, Host=f"localhost:{page.port}")[0] == 200


def test_stopping_needs_the_token_and_a_run(page: Page) -> None:
    assert page.ask("/stop", "POST")[0] == 403
    assert page.ask("/stop", "POST", X_Palpate_Token="guess")[0] == 403
    assert page.ask("/stop", "POST", X_Palpate_Token=page.token, Origin="http://evil.example")[0] == 403
    assert page.ask("/stop", "GET", X_Palpate_Token=page.token)[0] == 404
    status, text, _ = page.ask("/stop", "POST", X_Palpate_Token=page.token)
    assert (status, text) == (409, "nothing runs that could be stopped")


def test_nonsense_is_refused(page: Page) -> None:
    assert page.ask("/frame?t=soon")[0] == 400
    assert page.ask("/../config/rigs/bench.toml")[0] == 404
    assert page.ask("/server.py")[0] == 404
    assert page.json("/frame?t=nan")["t"] >= 0
    assert page.json("/frame?t=-1e300")["t"] >= 0


def test_it_listens_on_this_computer_only(page: Page) -> None:
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    rows += [line.split() for line in Path("/proc/net/tcp6").read_text().splitlines()[1:]]
    listening = {row[1] for row in rows if row[3] == "0A"}
    assert {place for place in listening if int(place.split(":")[1], 16) == page.port} == {
        f"0100007F:{page.port:04X}"
    }


def test_what_cannot_be_served_or_read_is_one_line(session: Path, tmp_path: Path) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        words = [PALPATE, "view", session, "--port", str(server.getsockname()[1])]
        done = subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "cannot be served: Address already in use; choose another with --port" in done.stderr
    done = subprocess.run(
        [PALPATE, "view", tmp_path], capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "is not a session" in done.stderr


def test_a_log_that_was_changed_is_shown_up_to_there_and_says_so(session: Path, tmp_path: Path) -> None:
    folder = tmp_path / "changed"
    shutil.copytree(session, folder)
    lines = log_lines(folder / "session.jsonl.zst")
    at = next(k for k, line in enumerate(lines) if '"event":"touches"' in line)
    write_log(folder / "session.jsonl.zst", [*lines[:at], "nonsense\n", *lines[at:]])
    with viewed(folder) as page:
        last = page.json("/frame?t=1e9")
    assert last["end"]["how"] == "unreadable"
    assert f"line {at + 1}: is not JSON" in last["end"]["message"]
    assert (last["stage"], last["contacts"]) == ("retracting", [])


def running(folder: Path) -> AbstractContextManager[tuple[Started, Page]]:
    """A run with its view, whose fingers creep."""
    return page_of("identify", "--rig", slow_rig(folder), "--view", "--view-port", cwd=folder)


def until_closing(page: Page) -> dict[str, Any]:
    def closing() -> dict[str, Any] | None:
        frame: dict[str, Any] = page.json("/frame?t=1e9")
        return frame if frame and frame["stage"] == "closing" else None

    return until(closing, "it never closed")  # type: ignore[return-value]


def test_the_stop_button_ends_the_run_with_torque_off(tmp_path: Path) -> None:
    with running(tmp_path) as (command, page):
        frame = until_closing(page)
        assert any(frame["torque"].values())
        assert pressed_by_request(page)
        done = command.ended()
    assert done.code == 130
    assert done.err.splitlines()[-2:] == ["interrupted", "torque is off"]
    (log,) = tmp_path.glob("palpate-sessions/*/session.jsonl.zst")
    events = log_events(log)
    assert (events[-1]["event"], events[-1]["how"]) == ("end", "Interrupted")
    last = dict(torque_writes(bytes_sent(events, "mock://bus")))
    assert {dxl_id: last[dxl_id] for dxl_id in (11, 12, 21, 22, 31, 32)} == dict.fromkeys(
        last.keys() - {254}, 0
    )


def pressed_by_request(page: Page) -> str:
    status, text, _ = page.ask("/stop", "POST", X_Palpate_Token=page.token)
    said = json.loads(text)
    assert (status, said["stopped"]) == (200, True)
    return str(said["words"])


def pressed_in_chromium(page: Page) -> str:
    with chromium() as browser:
        browser.get(f"http://127.0.0.1:{page.port}/")
        button = browser.find_element("id", "stop")
        until(button.is_displayed)
        button.click()
        until(lambda: button.text not in ("STOP", "stopping …"))
        return str(button.text)


@pytest.mark.realtime
@pytest.mark.slow
@pytest.mark.parametrize(
    "press", [pressed_by_request, pytest.param(pressed_in_chromium, marks=needs_chromium)]
)
def test_the_stop_button_of_a_run_on_ports_is_confirmed_and_the_vendors_sdk_finds_torque_off(
    press: Callable[[Page], str], tmp_path: Path
) -> None:
    rig, parts = quick_bench(tmp_path, fingers=2)
    with served(tmp_path, "--rig", rig, "--objects", parts, "--rig-out", "real.toml") as (_, told):
        words = ("identify", "--rig", "real.toml", "--objects", parts, "--view", "--view-port")
        with page_of(*words, cwd=tmp_path) as (run, page):
            frame = until_closing(page)
            assert any(frame["torque"].values())
            assert press(page) == "torque is off"
            assert run.ended().code in (3, 130)  # its port may have been taken from it first
        bus = dynamixel_sdk.PortHandler(told["ports"]["mock://bus"])
        assert bus.setBaudRate(1_000_000)
        packets = dynamixel_sdk.PacketHandler(2.0)
        try:
            answers = {dxl_id: packets.read1ByteTxRx(bus, dxl_id, 64)[:2] for dxl_id in (11, 12, 21, 22)}
        finally:
            bus.closePort()
        assert answers == dict.fromkeys(answers, (0, 0)), "off, and the reading went well"


def test_a_calibration_is_shown_and_leaves_nothing(tmp_path: Path) -> None:
    shutil.copy(firm_rig(), tmp_path / "rig.toml")
    port = free_port()
    words = ["calibrate", "--rig", "rig.toml", "tactile", "--yes", "--view", "--view-port", str(port)]
    said = (tmp_path / "said").open("wb")
    with said, subprocess.Popen([PALPATE, *words], cwd=tmp_path, stderr=said, stdout=said) as process:
        try:
            until(lambda: process.poll() is None and is_served(port))
            page = Page(port)
            until(lambda: len((page.json("/frame?t=1e9") or {"tips": ()})["tips"]) == 3)
            until(lambda: any(page.json("/frame?t=1e9")["torque"].values()))
            until(lambda: len(page.json("/frame?t=1e9")["arrays"]) == 3)
            frame = page.json("/frame?t=1e9")
            assert page.json("/setting")["outlines"] == {}
            assert (set(frame["arrays"]), frame["parts"]) == ({"f1", "f2", "f3"}, [])
            assert frame["doing"] in (tmp_path / "said").read_text(), "as the terminal says"
            folder = Path(
                next(
                    word for word in (tmp_path / "said").read_text().split() if "palpate-view-" in word
                ).strip(";")
            )
            assert folder.is_dir()
            assert pressed_by_request(page) == "stopped: the run switches torque off"
            assert process.wait(timeout=PATIENCE_S) == 130
        finally:
            process.kill()
    assert not folder.exists()
    assert "torque is off" in (tmp_path / "said").read_text()


def test_what_arrays_feel_is_shown(tmp_path: Path) -> None:
    with page_of("watch", "--for", 60, "--view", "--view-port", cwd=tmp_path) as (command, page):
        until(lambda: len((page.json("/frame?t=1e9") or {"arrays": ()})["arrays"]) == 3)
        frame = page.json("/frame?t=1e9")
        assert (frame["tips"], frame["torque"]) == ({}, {}), "nobody asks the servos"
        until(lambda: page.json("/frame?t=1e9")["frames"] > frame["frames"] + 100)
        assert command.ended(signal.SIGINT).code == 130
    until(lambda: not is_served(page.port))


def is_served(port: int) -> bool:
    with closing(socket.socket()) as client:
        return client.connect_ex(("127.0.0.1", port)) == 0


def test_pages_that_do_not_read_do_no_harm(tmp_path: Path) -> None:
    """As many as are served, and some that are not; the run goes on, and others are served."""
    with running(tmp_path) as (command, page), ExitStack() as stack:
        until_closing(page)
        answers = []
        for _ in range(40):
            silent = stack.enter_context(closing(socket.create_connection(("127.0.0.1", page.port))))
            silent.sendall(f"GET /stream HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n\r\n".encode())
            silent.settimeout(PATIENCE_S)
            answers.append(silent.recv(12))
        assert answers.count(b"HTTP/1.1 200") == 32
        assert answers.count(b"HTTP/1.1 503") == 8
        first = page.json("/extent")["last"]
        until(lambda: page.json("/extent")["last"] > first, "nobody else is served meanwhile")
        assert command.process.poll() is None


@contextmanager
def chromium() -> Iterator[Any]:
    webdriver = pytest.importorskip("selenium.webdriver")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for word in ("headless=new", "no-sandbox", "disable-gpu", "disable-quic", "no-first-run", "disable-sync"):
        options.add_argument(f"--{word}")
    options.add_argument("--disable-background-networking")
    options.add_argument("--disable-component-update")
    options.set_capability("goog:loggingPrefs", {"performance": "ALL", "browser": "ALL"})
    service = webdriver.ChromeService(shutil.which("chromedriver"))
    with webdriver.Chrome(options=options, service=service) as browser:
        yield browser


@needs_chromium
def test_the_page_in_chromium(session: Path, page: Page) -> None:
    """The slider shows any time of the run; nothing else is asked; nothing is said on the console."""
    with chromium() as browser:
        browser.get(f"http://127.0.0.1:{page.port}/")
        browser.implicitly_wait(10)
        find = browser.find_element
        until(lambda: find("id", "doing").text == "the run has ended")
        events = log_events(session / "session.jsonl.zst")
        (result,) = [event["result"] for event in events if event["event"] == "result"]
        assert find("id", "title").text.lower() == headline(IdentificationOut.model_validate(result)).lower()
        assert not find("id", "stop").is_displayed()
        for event in [item for item in events if item["event"] == "stage"]:
            browser.execute_script(
                "const s = document.getElementById('time'); s.value = arguments[0];"
                "s.dispatchEvent(new Event('input'))",
                event["t_s"] + 0.06,
            )
            words = f"grip {event['grip']}: {event['stage']}"
            until(lambda words=words: find("id", "doing").text.startswith(words), words)
        assert len(browser.find_elements("css selector", "#table .tip")) == 3
        assert len(browser.find_elements("css selector", "#arrays svg")) == 3
        said = [item for item in browser.get_log("browser") if item["level"] == "SEVERE"]
        assert said == []
        requests = [json.loads(item["message"])["message"] for item in browser.get_log("performance")]
        urls = {
            item["params"]["request"]["url"]
            for item in requests
            if item["method"] == "Network.requestWillBeSent"
        }
        elsewhere = {url for url in urls if not url.startswith(f"http://127.0.0.1:{page.port}/")}
        assert {url for url in elsewhere if not url.startswith(("data:", "chrome:", "about:"))} == set()
