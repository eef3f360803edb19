"""A rig that is ready: single touches and grips with the guards of `identify`, and what to touch next."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from palpate.base.errors import InputError, warn_operator
from palpate.base.vocabulary import Strategy
from palpate.drivers.transport import Clock
from palpate.jobs.files import ObjectsLike, check_arguments, name_of, objects_from, select_known
from palpate.recognizer import FingerApproach
from palpate.rig.bench import check_heights
from palpate.rig.catalogue.preparation import prepare_catalogue
from palpate.rig.conversion import finger_of
from palpate.rig.identification.exploration import fast_to_workspace
from palpate.rig.identification.part_count import PartCount, check_parts
from palpate.rig.identification.rig_recognition import GripPlanner, MadeGrip, RigRecognition
from palpate.rig.motion.hand import Hand
from palpate.rig.session.carried_grips import GripRecorder


class ReadyRig(GripPlanner):
    """A rig whose fingers are ready to touch. Torque is on, and off when its `with` block is left.

    Fingers stand retracted between two grips, outside of the workspace, and hold there.
    """

    def __init__(
        self, hand: Hand, connection: ExitStack, grips: GripRecorder, clock: Clock, session: Path | None
    ) -> None:
        """`Rig.connect` makes one; `connection` is closed when a grip fails. `clock`: the rig's."""
        super().__init__(hand.rig)
        self.hand = hand
        self.session = session
        """Folder of the session, if one is kept."""
        self._connection: ExitStack | None = connection
        self._grips, self._clock = grips, clock
        connection.callback(self._end)

    @property
    def is_connected(self) -> bool:
        """False once a grip has failed."""
        return self._connection is not None

    @property
    def time_s(self) -> float:
        """Present time on the rig's clock."""
        return self._clock.now()

    def _end(self) -> None:
        self._connection = None

    @check_arguments
    def recognise(self, objects: ObjectsLike | None = None, *, parts: int | str = 1) -> RigRecognition:
        """Recognise nothing yet: anything of the catalogue may lie anywhere; `extend` it with grips.

        `objects`: None for the shipped ones. `parts`: how many lie there, as of `Rig.identify`. States that
        are not known at the fingers' heights are left out, with a warning. Raises InputError if a file is
        wrong, no state is left, or a part is too high.
        """
        models, _ = select_known(objects_from(objects), self.file.fingers, name_of(objects), warn_operator)
        check_heights(self.file, models)
        count = PartCount.parse(parts)
        check_parts(self.file, count, Strategy.PLANNED)
        return self._begin(prepare_catalogue(models.objects, map(finger_of, self.file.fingers)), count)

    def touch(self, approach: FingerApproach) -> MadeGrip:
        """Touch with one finger: as `grip` of one approach."""
        return self.grip([approach])

    def grip(self, approaches: Sequence[FingerApproach]) -> MadeGrip:
        """Grip: let fingers aim, close until each meets something or its end, measure, and retract.

        Approaches are those of a plan, or of `approaches`, also shortened; each finger has one at most.
        Returns the contacts with their bounds, misses included. Raises InputError, and moves nothing, for
        other approaches; DeviceError, SafetyStop as `identify` does. After any error but the first, torque
        is off and the rig connected no longer, even if the error is caught.
        """
        return self.carry_out(self.check(approaches))

    def carry_out(self, approaches: Sequence[FingerApproach]) -> MadeGrip:
        """Grip as `grip` does, of approaches that a search within the rig's reach has chosen."""
        if self._connection is None:
            raise InputError("this rig is connected no longer: grip inside of the `with` block of connect")
        radius = self.file.workspace.radius_mm
        ways = [item if item.fast_mm else fast_to_workspace(item, radius) for item in approaches]
        try:
            touches = self._grips.carry_out(self.hand, ways)
        except BaseException as error:
            self._connection.__exit__(type(error), error, error.__traceback__)
            raise
        return MadeGrip.of(self.file, approaches, touches)
