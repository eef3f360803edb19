"""The result of a stop, for the terminal."""

from rich.console import Console

from palpate.base.errors import counted
from palpate.config.stop_result import StopOut

__all__ = ["show"]


def show(out: StopOut, console: Console) -> None:
    """Which servos have confirmed that torque is off, and what to do about the others."""

    def say(text: str, style: str) -> None:
        console.print(text, style=style, highlight=False, markup=False)

    where = f"on {out.port} at {out.baudrate_bps} baud{' (emulated)' if out.emulated else ''}"
    off = [servo for servo in out.servos if servo.off]
    ids = ", ".join(str(servo.id) for servo in off)
    if off:
        say(f"torque is off, confirmed: {counted(len(off), 'servo', 'servos')} {where} ({ids})", "green")
    for servo in out.servos:
        if not servo.off:
            name = f"servo {servo.id}" + (f" ({servo.owner})" if servo.owner else "")
            say(f"NOT confirmed: {name}: {servo.problem}", "bold red")
    if out.taken:
        say(
            f"NOT confirmed: another program is using {out.port}; every servo {where} was sent "
            f"Torque Enable = 0 {out.told} times",
            "bold red",
        )
    elif not out.servos:
        say(f"NOT confirmed: no servo answers {where}; is it the right port and baud rate?", "bold red")
    if not out.confirmed:
        say("if anything may still move, cut the servos' power", "bold red")
