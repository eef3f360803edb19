"""Ways out of a run on real ports, and each servo's Torque Enable afterwards, read by the vendor's SDK.

    python benchmarks/bench_ways_out.py [--jobs 2] [--only WORDS]      # twenty minutes; notebooks: ipykernel

Each way is tried on an emulated bench that another process serves on pseudo-terminals in real time. While
fingers close, the program ends, is ended, or loses something; a second later the SDK asks every servo, over
the same port. Prints one line a way and ends with exit code 1 if a servo's torque was on.

Results stand in docs/safety.md, "Ways out".
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import serial
from dynamixel_sdk import PacketHandler, PortHandler, port_handler

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from support.benches.rigs import quick_bench
from support.commands.command import log_bytes

PALPATE = [sys.executable, "-m", "palpate"]
IDS = (11, 12, 21, 22)
TORQUE_ENABLE, BUS_WATCHDOG, PRESENT_VELOCITY = 64, 98, 128

PROGRAM = """
import asyncio, ctypes, multiprocessing, os, resource, signal, subprocess, sys, threading, time
from concurrent.futures import ThreadPoolExecutor
import palpate

closing, driver = threading.Event(), 0

def raise_in_driver(kind):
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(driver), ctypes.py_object(kind))

def kill(number):
    os.kill(os.getpid(), number)

def observe(event):
    if isinstance(event, palpate.StageEvent) and event.stage.value == "closing" and not closing.is_set():
        print("closing", flush=True)
        open("closing", "w").close()
        closing.set()
        time.sleep(0.2)
        {observer}

def drive():
    global driver
    driver = threading.get_ident()
    with palpate.open_rig("real.toml") as rig:
        answer = rig.identify("small-parts.json", sessions="sessions", on_event=observe)
    print("answer", answer.verdict, answer.failure, flush=True)

def meanwhile():
    closing.wait(60)
    time.sleep(0.3)
    {meanwhile}

async def in_asyncio(act):
    task = asyncio.create_task(asyncio.to_thread(drive))
    while not closing.is_set():
        await asyncio.sleep(0.05)
    await asyncio.sleep(0.3)
    act(task)
    await task

if __name__ == "__main__":
    {begin}
"""

MAIN = "threading.Thread(target=meanwhile, daemon=True).start(); drive()"
THREAD = "t = threading.Thread(target=drive); t.start(); meanwhile(); t.join()"
DAEMON = "t = threading.Thread(target=drive, daemon=True); t.start(); meanwhile(); "
POOL = "pool = ThreadPoolExecutor(); f = pool.submit(drive); meanwhile(); f.result()"
ASYNC = "asyncio.run(in_asyncio(lambda task: {}))"
PROCESS = (
    "p = multiprocessing.get_context('spawn').Process(target=drive{}); p.start()\n"
    "    while not os.path.exists('closing'): time.sleep(0.1)\n    time.sleep(0.3); {}; p.join()"
)


@dataclass(frozen=True)
class Way:
    """A way out: how the run is begun, what the program does then, and what is done to it from outside."""

    name: str
    begin: str = MAIN
    meanwhile: str = "pass"
    observer: str = "pass"
    outside: Callable[["subprocess.Popen[str]"], None] | None = None
    shell: str = ""
    command: bool = False
    tcp: bool = False


def send(*numbers: signal.Signals, gap_s: float = 0.01) -> Callable[["subprocess.Popen[str]"], None]:
    """Signals from outside, one after the other."""

    def act(program: "subprocess.Popen[str]") -> None:
        for number in numbers:
            with suppress(ProcessLookupError):
                program.send_signal(number)
            time.sleep(gap_s)

    return act


def send_group(*numbers: signal.Signals) -> Callable[["subprocess.Popen[str]"], None]:
    """Signals to the whole process group, as a terminal or a service manager sends them."""

    def act(program: "subprocess.Popen[str]") -> None:
        for number in numbers:
            with suppress(ProcessLookupError):
                os.killpg(program.pid, number)
            time.sleep(0.05)

    return act


def close_reader(program: "subprocess.Popen[str]") -> None:
    """Close the pipe that takes standard output."""
    assert program.stdout is not None
    program.stdout.close()


S = signal.Signals
SIGNALS = (
    S.SIGINT,
    S.SIGTERM,
    S.SIGHUP,
    S.SIGUSR1,
    S.SIGUSR2,
    S.SIGALRM,
    S.SIGXCPU,
    S.SIGQUIT,
    S.SIGABRT,
    S.SIGSEGV,
    S.SIGKILL,
)


def ways() -> Iterator[Way]:
    """All of them."""
    for number in SIGNALS:
        yield Way(f"{number.name}, command", command=True, outside=send(number))
        yield Way(f"{number.name}, main thread", outside=send(number))
        yield Way(f"{number.name}, daemon thread", DAEMON + "t.join()", outside=send(number))
    for number in (S.SIGINT, S.SIGTERM, S.SIGUSR1, S.SIGKILL):
        yield Way(f"{number.name}, thread", THREAD, outside=send(number))
        yield Way(f"{number.name}, executor", POOL, outside=send(number))
        yield Way(f"{number.name}, asyncio.to_thread", ASYNC.format("None"), outside=send(number))
    yield Way("SIGKILL, main thread, socket://", outside=send(S.SIGKILL), tcp=True)
    yield Way("SIGTERM, daemon thread, socket://", DAEMON + "t.join()", outside=send(S.SIGTERM), tcp=True)
    yield Way("SIGINT twice, thread", THREAD, outside=send(S.SIGINT, S.SIGINT, gap_s=0.5))
    yield Way("SIGINT twice, executor", POOL, outside=send(S.SIGINT, S.SIGINT, gap_s=0.5))
    yield Way("SIGINT 20 times, command", command=True, outside=send(*[S.SIGINT] * 20))
    mixed = send(S.SIGTERM, S.SIGINT, S.SIGHUP, S.SIGUSR1, gap_s=0.05)
    yield Way("SIGTERM, SIGINT, SIGHUP, SIGUSR1, command", command=True, outside=mixed)
    yield Way("SIGINT, then SIGKILL, command", command=True, outside=send(S.SIGINT, S.SIGKILL, gap_s=0.02))
    yield Way("SIGTERM, then SIGKILL, to the group", command=True, outside=send_group(S.SIGTERM, S.SIGKILL))
    yield Way("SIGKILL to the group", command=True, outside=send_group(S.SIGKILL))
    yield Way(
        "own handler of SIGTERM, main thread",
        "signal.signal(signal.SIGTERM, lambda *_: sys.exit(9)); " + MAIN,
        outside=send(S.SIGTERM),
    )
    stopped = send(S.SIGSTOP, S.SIGKILL, gap_s=2.0)
    yield Way("SIGSTOP, 2 s later SIGKILL", outside=stopped)
    yield Way("SIGSTOP for 2 s", outside=send(S.SIGSTOP, S.SIGCONT, gap_s=2.0))
    yield from _ends_by_itself()
    yield from _losses()


def _ends_by_itself() -> Iterator[Way]:
    yield Way("main returns, daemon thread", DAEMON)
    yield Way("main returns, thread", THREAD)
    yield Way("sys.exit in main, daemon thread", DAEMON + "sys.exit(3)")
    yield Way("main raises, daemon thread", DAEMON + "1 / 0")
    yield Way("main raises, executor", POOL.replace("f.result()", "1 / 0"))
    yield Way("cancel of asyncio.to_thread", ASYNC.format("task.cancel()"))
    yield Way("asyncio.run raises", ASYNC.format("1 / 0"))
    for error in ("SystemExit(5)", "KeyboardInterrupt", "MemoryError", "GeneratorExit", "BaseException('x')"):
        yield Way(f"observer raises {error}", observer=f"raise {error}")
    yield Way("sys.exit in observer, thread", THREAD, observer="sys.exit(5)")
    for error in ("KeyboardInterrupt", "SystemExit", "ValueError"):
        yield Way(f"{error} set in the driving thread", meanwhile=f"raise_in_driver({error})")
        yield Way(f"{error} set in the driving thread, executor", POOL, f"raise_in_driver({error})")
    for begin, where in ((MAIN, "main thread"), (DAEMON + "t.join()", "daemon thread")):
        yield Way(f"os._exit, {where}", begin, "os._exit(7)")
        yield Way(f"os.abort, {where}", begin, "os.abort()")
        yield Way(f"segmentation fault, {where}", begin, "ctypes.string_at(0)")
        yield Way(f"os.execv of another program, {where}", begin, "os.execv('/bin/true', ['true'])")
    yield Way("process of multiprocessing terminated", PROCESS.format("", "p.terminate()"))
    yield Way("process of multiprocessing killed", PROCESS.format("", "p.kill()"))
    yield Way("daemon process, parent ends", PROCESS.format(", daemon=True", "sys.exit(0)"))
    yield Way("daemon process, parent killed", PROCESS.format(", daemon=True", "kill(9)"))


def _losses() -> Iterator[Way]:
    fork = "p = os.fork(); "
    yield Way("os.fork in observer, child exits", observer=fork + "p or sys.exit(0)")
    yield Way("os.fork in observer, parent killed", observer=fork + "p or time.sleep(9); kill(9)")
    yield Way("os.fork in main, child returns", DAEMON + "os.fork() or os._exit(0); t.join()")
    yield Way("all files closed", meanwhile="os.closerange(3, 200)")
    limit = "resource.setrlimit(resource.RLIMIT_{}, ({}, resource.RLIM_INFINITY))"
    yield Way("no memory (RLIMIT_AS)", meanwhile=limit.format("AS", 1))
    yield Way("no file sizes (RLIMIT_FSIZE)", meanwhile=limit.format("FSIZE", 20000))
    yield Way("CPU time (ulimit -S -t 4)", command=True, shell="ulimit -S -t 4;")
    yield Way("CPU time (ulimit -t 4)", command=True, shell="ulimit -t 4;")
    yield Way("reader of standard output gone", command=True, outside=close_reader)
    yield Way("interpreter lock held for 3 s", meanwhile="ctypes.PyDLL(None).usleep(3000000)")
    yield Way("no standard streams", command=True, shell="exec 0<&- 2>&-;")
    yield Way("endless recursion in observer", observer="f = lambda f: f(f); f(f)")
    if find_spec("ipykernel"):
        for what in ("interrupt", "shutdown", "kill", "interrupt of a thread's", "shutdown of a thread's"):
            yield Way(f"notebook: {what}", "")


NOTEBOOK = """
import sys, time
from jupyter_client.manager import start_new_kernel
what = sys.argv[1]
manager, client = start_new_kernel(kernel_name="python3")
text = open("program.py").read()
cell = "t = threading.Thread(target=drive, daemon=True); t.start()" if "thread" in what else "drive()"
client.execute(text.replace('if __name__ == "__main__":', 'if True:') + cell)
while True:
    message = client.get_iopub_msg(timeout=90)
    if "closing" in str(message["content"].get("text")):
        break
print("closing", flush=True)
time.sleep(0.5)
if what.startswith("interrupt"):
    manager.interrupt_kernel()
    time.sleep(3.0 if "thread" not in what else 60.0)
elif what.startswith("shutdown"):
    manager.shutdown_kernel(now=False)
else:
    manager.shutdown_kernel(now=True)
print("done", flush=True)
if what.startswith("interrupt"):
    print(sys.stdin.readline())
    manager.shutdown_kernel(now=True)
"""


@contextmanager
def served(folder: Path, tcp: bool) -> Iterator[str]:
    """Serve the bench; the URL of its bus."""
    rig, parts = quick_bench(folder, fingers=2)
    words = [
        "emulate",
        "--rig",
        rig,
        "--objects",
        parts,
        "--seed",
        "7",
        "--rig-out",
        "real.toml",
        "--for",
        "200",
    ]
    with (folder / "emulate.txt").open("w") as errors:
        bench = subprocess.Popen(
            [*PALPATE, *map(str, words), "--tcp" if tcp else "--pty"],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
        )
        try:
            assert bench.stdout is not None
            yield json.loads(bench.stdout.readline())["ports"]["mock://bus"]
        finally:
            bench.kill()
            bench.wait()


def judged(url: str) -> dict[int, tuple[int | None, ...]]:
    """Torque Enable, Bus Watchdog, Present Velocity of each servo, by the vendor's SDK; None: no answer."""
    done = subprocess.run(
        [sys.executable, __file__, "--judge", url], capture_output=True, text=True, timeout=90, check=False
    )
    assert done.returncode == 0, done.stderr
    return {int(dxl_id): tuple(found) for dxl_id, found in json.loads(done.stdout).items()}


def judge(url: str) -> None:
    """Print what `judged` returns, from a process of its own: the SDK is changed for slow terminals."""
    port_handler.LATENCY_TIMER = 120
    if url.startswith("socket"):
        port_handler.serial.Serial = lambda port, **words: serial.serial_for_url(port, **words)  # noqa: PLW0108
    port, packets = PortHandler(url), PacketHandler(2.0)
    port.setBaudRate(1_000_000)
    found: dict[int, list[int | None]] = {}
    for dxl_id in IDS:
        found[dxl_id] = []
        for address, read in (
            (TORQUE_ENABLE, packets.read1ByteTxRx),
            (BUS_WATCHDOG, packets.read1ByteTxRx),
            (PRESENT_VELOCITY, packets.read4ByteTxRx),
        ):
            value = None
            for _ in range(6):
                with suppress(IndexError):  # a defect of the SDK
                    data, lost, _error = read(port, dxl_id, address)
                    if lost == 0:
                        value = data
                        break
            found[dxl_id].append(value)
    print(json.dumps(found))


def started(way: Way, folder: Path) -> "subprocess.Popen[str]":
    """The program of a way."""
    if way.command:
        words = ["identify", "--rig", "real.toml", "--objects", "small-parts.json", "--sessions", "sessions"]
        command = [*PALPATE, *words]
    else:
        text = PROGRAM.format(observer=way.observer, meanwhile=way.meanwhile, begin=way.begin or "pass")
        (folder / "program.py").write_text(text, encoding="utf-8")
        command = [sys.executable, "program.py"]
    if not way.begin:
        (folder / "notebook.py").write_text(NOTEBOOK, encoding="utf-8")
        command = [sys.executable, "notebook.py", way.name.removeprefix("notebook: ")]
    if way.shell:
        command = ["bash", "-c", way.shell + ' exec "$@"', "x", *command]
    pipe = subprocess.PIPE
    return subprocess.Popen(
        command, cwd=folder, stdin=pipe, stdout=pipe, stderr=pipe, text=True, start_new_session=True
    )


def until_closing(program: "subprocess.Popen[str]", way: Way, folder: Path) -> None:
    """Wait until fingers close, and 0.3 s longer."""
    deadline = time.monotonic() + 60
    while way.command and time.monotonic() < deadline and program.poll() is None:
        log = next((folder / "sessions").glob("*/session.jsonl.zst"), None)
        if log is not None and b'"stage":"closing"' in log_bytes(log):
            break
        time.sleep(0.05)
    if not way.command:
        assert program.stdout is not None
        program.stdout.readline()
    time.sleep(0.3)


def tried(way: Way) -> tuple[Way, bool, str]:
    """Whether torque was off on all, and a line about it."""
    with tempfile.TemporaryDirectory() as place, served(Path(place), way.tcp) as url:
        folder = Path(place)
        with started(way, folder) as program:
            if not way.shell:
                until_closing(program, way, folder)
            if way.outside is not None:
                way.outside(program)
            try:
                _, errors = program.communicate(timeout=100) if way.begin else (None, "")
                if not way.begin:
                    program.stdout.readline()
            except (subprocess.TimeoutExpired, ValueError):  # the reader is closed
                errors = ""
                with suppress(subprocess.TimeoutExpired):
                    program.wait(60)
            code = program.poll()
            time.sleep(1.0)
            found = judged(url)
            program.kill()
    on = [dxl_id for dxl_id, (torque, *_) in found.items() if torque != 0]
    moving = [dxl_id for dxl_id, (*_, speed) in found.items() if speed is None or 2 < speed < 2**32 - 2]
    last = (errors or "").strip().splitlines()[-1:]
    line = f"| {way.name} | {code} | {on or 'off'} | {moving or 'none'} | {' '.join(last)[:110]} |"
    return way, not on and not moving, line


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", default="")
    parser.add_argument("--skip", type=int, default=0)
    parser.add_argument("--judge")
    args = parser.parse_args()
    if args.judge:
        judge(args.judge)
        return
    chosen = [way for way in ways() if args.only in way.name][args.skip :]
    good = 0
    print("| way out | exit code | torque | moving | last line |\n|---|---|---|---|---|", flush=True)
    with ThreadPoolExecutor(args.jobs) as pool:
        for _, well, line in pool.map(tried, chosen):
            good += well
            print(line + ("" if well else "  <-- "), flush=True)
    print(f"\n{good} of {len(chosen)} with torque off on all and nothing moving")
    sys.exit(good < len(chosen))


if __name__ == "__main__":
    main()
