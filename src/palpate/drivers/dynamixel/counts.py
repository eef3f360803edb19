"""What a bus has been through: the numbers behind "the wire is bad". Kept by `bus`, shown by `rig`."""

from dataclasses import dataclass, fields

__all__ = ["BusCounts"]


@dataclass(slots=True)
class BusCounts:
    """How often what happened since the port was opened.

    `instructions`: packets sent. `silent`: answers that did not come in time. `damaged`: answers that came
    broken. `retries`: instructions that were sent once more because of it. `alerts`: answers of servos that
    report a hardware error. `reconnects`: ports opened again. `stale`: answers that came late or twice and
    were dropped, because they answered what had been asked before.
    """

    instructions: int = 0
    silent: int = 0
    damaged: int = 0
    retries: int = 0
    alerts: int = 0
    reconnects: int = 0
    stale: int = 0

    def lost(self, *, silent: bool) -> None:
        """Count an answer that did not come, or came broken."""
        if silent:
            self.silent += 1
        else:
            self.damaged += 1

    def as_dict(self) -> dict[str, int]:
        """The numbers by name."""
        return {item.name: getattr(self, item.name) for item in fields(self)}
