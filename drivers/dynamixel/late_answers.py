"""Answers that may still come although their time is up. Beside `exchange`, which asks here first.

No packet of Protocol 2.0 says which instruction it answers. A late answer is told from the answer to the
next question by its servo and, if both are reads of one block, need not be; everything else has to wait
until it can no longer come.
"""

from collections.abc import Iterable, Mapping

__all__ = ["LateAnswers", "Question"]

Question = tuple[int, bytes]
"""What a servo was asked: the instruction and its parameters; for a read of any kind, READ and the block."""


class LateAnswers:
    """Which servo may still answer what, and until when (s)."""

    def __init__(self, quiet_s: float) -> None:
        """`quiet_s`: how much later than its time-out an answer can come at most."""
        self._quiet_s = quiet_s
        self._late: dict[int, tuple[Question | None, float]] = {}
        self._hidden: set[int] = set()

    def expect(self, dxl_id: int, question: Question | None, now: float, *, hidden: bool = False) -> None:
        """An answer of this servo may come from now on; None: to whatever.

        `hidden`: it was only silent because another one was, which it waits for.
        """
        self._late[dxl_id] = (question, now + self._quiet_s)
        (self._hidden.add if hidden else self._hidden.discard)(dxl_id)

    def outdate(self) -> None:
        """Something was written: what a late answer says may no longer hold."""
        self._late = {dxl_id: (None, until) for dxl_id, (_, until) in self._late.items()}

    def pending(self, dxl_ids: Iterable[int], now: float) -> list[int]:
        """Those of the servos of which an answer may still come, and that were not only hidden."""
        late = [dxl_id for dxl_id in dxl_ids if dxl_id in self._late and dxl_id not in self._hidden]
        return [dxl_id for dxl_id in late if now < self._late[dxl_id][1]]

    def renew(self, dxl_ids: Iterable[int], now: float) -> None:
        """Answers came of servos that had been asked more than once: which one it was is not known."""
        for dxl_id in dxl_ids:
            self.expect(dxl_id, self._late[dxl_id][0], now)

    def clear_at(self, questions: Mapping[int, Question], now: float) -> float:
        """Instant from which on no late answer can be taken for the answer to one of these questions.

        The late answer to the same question, and that of a servo that is not asked, does no harm.
        """
        self._late = {dxl_id: item for dxl_id, item in self._late.items() if item[1] > now}
        return max(
            (
                until
                for dxl_id, (asked, until) in self._late.items()
                if dxl_id in questions and questions[dxl_id] != asked
            ),
            default=now,
        )
