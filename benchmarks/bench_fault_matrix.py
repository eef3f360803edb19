"""The fault matrix: every fault in every phase of every command that moves; who ends with torque on?

    python benchmarks/bench_fault_matrix.py                # all cells, one instant each
    python benchmarks/bench_fault_matrix.py --draws 3      # three instants each
    python benchmarks/bench_fault_matrix.py --guards       # with each guard removed: which cells then fail
    python benchmarks/bench_fault_matrix.py --page         # writes docs/safety.md's table anew, runs nothing

Emulated bench, virtual time; what is looked at afterwards are the devices' own registers. Prints what each
row came to, the slowest stop and the longest travel by phase, and every cell that is not as its row says;
exit code 1 if there is one.
"""

import argparse
import re
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from palpate.drivers.dynamixel import bus, control_table, servo, servo_state
from palpate.drivers.transport import recording
from palpate.rig.motion import array_guard, finger_movers, hand
from palpate.rig.session import log
from support.benches.fault_matrix import Cell, Outcome, cells, problems, run_cell, write_page
from support.benches.fault_rows import FAULTS, LOOKED

Result = tuple[Cell, Outcome, list[str]]


def replace_guard(owner: object, name: str, stand_in: object) -> None:
    """Put `stand_in` in the place of a guard; AttributeError if there is none of that name to be removed."""
    getattr(owner, name)
    setattr(owner, name, stand_in)


def without_force() -> None:
    """No force counts as too high."""
    replace_guard(array_guard.ArrayGuard, "_check_force", lambda *_: None)


def without_silence() -> None:
    """Arrays may be silent for ever."""
    replace_guard(array_guard.ArrayGuard, "_check_heard", lambda *_: None)


def without_stall() -> None:
    """Fingers on their way may stand still for ever."""
    replace_guard(finger_movers, "_STALL_S", 1e9)
    replace_guard(finger_movers, "_MOVE_TIMEOUT_S", 30.0)


def without_torque_check() -> None:
    """Nobody looks whether torque is still on."""
    states = hand.Hand.states

    def trusting(self: hand.Hand, servos: Sequence[servo.Servo]) -> dict[int, object]:
        driven, self._driven = self._driven, False
        try:
            return states(self, servos)  # type: ignore[return-value]
        finally:
            self._driven = driven

    replace_guard(hand.Hand, "states", trusting)


def without_alerts() -> None:
    """Hardware errors in states are not raised."""
    whole = bus.GroupRead.all

    def without_errors(self: bus.GroupRead[object]) -> dict[int, object]:
        errors = {i: e for i, e in self.errors.items() if not hasattr(e, "carried_out")}
        return whole(replace(self, errors=errors))

    replace_guard(bus.GroupRead, "all", without_errors)


def without_restart_check() -> None:
    """A servo that has forgotten everything passes for one that has not."""
    layout = servo_state._STATE_LAYOUT

    class Forgiving:
        size = layout.size

        def unpack(self, data: bytes) -> tuple[int, ...]:
            *measured, _torque, watchdog, _level = layout.unpack(data)
            return (*measured, 1, watchdog, control_table.ANSWERS_ALL)

    replace_guard(servo_state, "_STATE_LAYOUT", Forgiving())


def without_watchdog() -> None:
    """Bus Watchdog is never armed."""
    replace_guard(servo.Servo, "arm_watchdog", lambda *_: None)


def without_output_check() -> None:
    """The log's failure is not looked at."""
    replace_guard(log.SessionLog, "check", lambda _: None)


def without_shield() -> None:
    """What a recording raises goes through, and the log is written by the thread that drives devices."""
    replace_guard(recording.Recorder, "note", lambda self, what: self._sink.note(what))
    replace_guard(log.SessionLog, "_put", lambda self, line: self._write([(line, "")]))


def without_sure_off() -> None:
    """Torque is switched off once, whatever interrupts it."""
    replace_guard(hand, "despite_interruptions", lambda switch_off: switch_off())


def without_reconnecting() -> None:
    """An adapter that comes back is not waited for."""
    replace_guard(array_guard, "_REPLUG_S", 0.0)


def without_asking_again() -> None:
    """Torque off and goals are told once, and answers asked for once."""
    replace_guard(servo, "_TORQUE_OFF_ROUNDS", 1)
    replace_guard(servo, "_MAX_GOAL_WRITES", 1)
    begin = bus.Bus.__init__
    replace_guard(bus.Bus, "__init__", lambda self, *args, **kw: begin(self, *args, **kw | {"retries": 0}))


GUARDS: dict[str, tuple[Callable[[], None], str]] = {
    "force": (without_force, "hard is pushed"),
    "silence of arrays": (without_silence, "array's cable"),
    "stall": (without_stall, "held elsewhere"),
    "torque is on": (without_torque_check, "another program"),
    "hardware error": (without_alerts, "hardware error"),
    "restart": (without_restart_check, "without power"),
    "Bus Watchdog": (without_watchdog, "cable breaks|unplugged|stops, or palpate"),
    "log's check": (without_output_check, "log's disk is full"),
    "log beside the thread": (without_shield, "log's disk is full"),
    "torque off, surely": (without_sure_off, "and again"),
    "adapter that comes back": (without_reconnecting, "unplugged for 3 s"),
    "asking again": (without_asking_again, "one in a hundred of"),
}
"""Guards: how each is removed, and words of the rows whose cells name it."""


def carried_out(cell: Cell) -> Result:
    """Run a cell and judge it."""
    found = run_cell(cell)
    return cell, found, problems(cell, found)


def run(chosen: Sequence[Cell], jobs: int, without: Callable[[], None] | None = None) -> list[Result]:
    """Run cells in processes of their own."""
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=without) as pool:
        results = []
        for result in pool.map(carried_out, chosen, chunksize=8):
            results.append(result)
            if sys.stderr.isatty():
                print(f"\r{len(results)} of {len(chosen)}", end="", file=sys.stderr)
        return results


def show(results: Iterable[Result]) -> int:
    """Tables by row and by phase, and what is wrong; how many cells are."""
    rows, phases, wrong = defaultdict(list), defaultdict(list), 0
    for cell, found, bad in results:
        rows[cell.fault].append((found, bad))
        if cell.phase in LOOKED and found.error is not None:
            phases[cell.phase].append((cell, found))
        if bad:
            wrong += 1
            print(f"WRONG {cell} [{cell.draw}]: {'; '.join(bad)}")
    print(f"{'fault':66}{'cells':>6}{'ended':>6}{'wrong':>6}{'N':>6}{'mm':>6}")
    for number, items in sorted(rows.items()):
        print(
            f"{FAULTS[number].name:66}{len(items):6}{sum(f.error is not None for f, _ in items):6}"
            f"{sum(bool(bad) for _, bad in items):6}{max(f.hardest_n for f, _ in items):6.1f}"
            f"{max(f.travel_mm for f, _ in items if True):6.1f}"
        )
    print(f"\n{'phase':24}{'cells':>6}{'stop s':>8}{'mm':>6}  slowest")
    for phase, found_in in sorted(phases.items()):
        slowest, found = max(found_in, key=lambda item: item[1].stop_s)
        longest = max(item.travel_mm for _, item in found_in)
        print(f"{phase:24}{len(found_in):6}{found.stop_s:8.2f}{longest:6.1f}  {slowest.row.name}")
    return wrong


_QUICK = ("identify", "calibrate")  # `check --touch` moves as these do


def try_guards(jobs: int) -> int:
    """Remove each guard in turn; how many removals went unnoticed."""
    unnoticed = 0
    for name, (remove, words) in GUARDS.items():
        chosen = [
            cell
            for cell in cells()
            if re.search(words, cell.row.name) and cell.phase in LOOKED and cell.command in _QUICK
        ]
        failed = sum(bool(bad) for _, _, bad in run(chosen, jobs, remove))
        unnoticed += failed == 0
        print(
            f"without {name:28}{failed:4} of {len(chosen):4} cells fail{'' if failed else '  UNNOTICED'}",
            flush=True,
        )
    return unnoticed


def main() -> int:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--draws", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", default="", help="words of a cell's name")
    parser.add_argument("--guards", action="store_true")
    parser.add_argument("--page", action="store_true")
    asked = parser.parse_args()
    if asked.page:
        write_page()
        return 0
    begin = time.perf_counter()
    if asked.guards:
        wrong = try_guards(asked.jobs)
    else:
        chosen = [cell for cell in cells(asked.draws) if asked.only in str(cell)]
        wrong = show(run(chosen, asked.jobs))
        print(f"\n{len(chosen)} cells, {wrong} wrong", end="")
    print(f", {time.perf_counter() - begin:.0f} s")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
