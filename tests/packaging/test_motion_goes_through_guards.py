"""Nothing moves, and no time passes while something may move, but through the guarded loop."""

import ast

from repository import PACKAGE


def calls(folder: str) -> list[tuple[str, str]]:
    """(file, name of what is called) of every call below a folder."""
    found = []
    for file in sorted((PACKAGE / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                name = (
                    node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                )
                found.append((f"{folder}/{file.relative_to(PACKAGE / folder)}", name))
    return found


def test_goals_are_written_by_the_guarded_loop_alone() -> None:
    writers = {"write_goals", "stop_at"}
    everywhere = [*calls("cli"), *calls("jobs"), *calls("rig"), *calls("calibration"), *calls("drivers")]
    assert {file for file, name in everywhere if name in writers} == {"drivers/dynamixel/guarded_motion.py"}


def test_a_connected_rig_lets_time_pass_in_one_place() -> None:
    """`Hand.pause` looks at arrays; what waits without a hand moves nothing."""
    sleepers = {file for file, name in [*calls("cli"), *calls("jobs"), *calls("rig")] if name == "sleep"}
    without_hand = {
        "rig/diagnostics/host_ports.py",
        "jobs/monitor.py",
        "rig/diagnostics/array_examination.py",
        "rig/array_playback.py",
    }
    waits_for_lost_devices = (
        "rig/motion/device_loss.py"  # an adapter that is gone, an array after fingers stopped
    )
    assert sleepers == {"rig/motion/hand.py", waits_for_lost_devices, *without_hand}
    assert "sleep" not in {name for _, name in calls("calibration")}


def test_no_wall_clock_decides_anything() -> None:
    """A clock that is set changes dates of files, and nothing else."""
    readers = [
        file
        for folder in ("drivers", "calibration", "recognizer")
        for file, name in calls(folder)
        if name in ("time", "time_ns", "utcnow", "today")
    ]
    assert readers == []
