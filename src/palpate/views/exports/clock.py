"""Log time of exports: nanoseconds since 1970 of instants on the rig's clock."""

from dataclasses import dataclass
from datetime import datetime
from typing import Self

__all__ = ["LogClock"]


@dataclass(frozen=True)
class LogClock:
    """`begin_ns`: when the rig's clock was 0."""

    begin_ns: int

    @classmethod
    def of(cls, started: datetime | None) -> Self:
        """For a run that began at an instant; 1970 where it is not known."""
        return cls(0 if started is None else round(started.timestamp()) * 10**9)

    def ns(self, t_s: float) -> int:
        """Of an instant on the rig's clock."""
        return self.begin_ns + round(t_s * 1e9)
