"""A rig's description, format `palpate/rig@1`: TOML in, one checked `RigFile` out.

Says which servos and arrays hang on which ports, where the fingers stand, how well all that is known, and
how carefully to move. The values keep the file's units, which are the suffixes of their names: mm, degrees,
N, Hz; `rig` turns them into mm, rad, s, N where it builds the bench. `docs/rig-file.md` explains every key.
"""

import math
from typing import Literal, Self

from pydantic import Field, model_validator

from palpate.config.fields import FileModel, Items, Name
from palpate.config.loading import Source, load_toml
from palpate.config.rig_checks import (
    check_emulation,
    check_identities,
    check_obstacles,
    check_pads,
    check_places,
    check_real,
    check_stops_known,
)
from palpate.config.rig_fingers import FingerConfig
from palpate.config.rig_servos import StageConfig
from palpate.config.rig_tables import (
    BusConfig,
    ClosingConfig,
    EmulationConfig,
    ObstacleConfig,
    SearchConfig,
    WorkspaceConfig,
)

__all__ = ["RigFile", "load_rig"]


class RigFile(FileModel):
    """A bench rig of tactile fingers, `palpate/rig@1`."""

    format: Literal["palpate/rig@1"]
    name: Name
    bus: BusConfig
    workspace: WorkspaceConfig
    closing: ClosingConfig
    search: SearchConfig
    fingers: Items[FingerConfig] = Field(
        min_length=1, description="The fingers, in the order they are reported."
    )
    stage: StageConfig | None = Field(default=None, description="The turning stage, if there is one.")
    obstacles: Items[ObstacleConfig] = Field(default=[], description="What stands in the fingers' plane.")
    emulation: EmulationConfig | None = Field(default=None, description="Only for rigs with mock:// ports.")

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        clearance = self.closing.clearance_mm
        check_identities(self.fingers, self.bus, self.stage)
        check_places(self.fingers, self.clear_radius_mm, clearance)
        check_obstacles(self.obstacles, self.fingers, self.clear_radius_mm, clearance)
        check_pads(self.fingers, self.search.part_holds_n, self.emulation)
        if self.search.check_slips:
            check_stops_known(self.fingers)
        if self.emulation is None:
            check_real(self.fingers, self.bus)
        else:
            check_emulation(self.emulation, self.fingers, self.bus, self.stage, self.workspace.radius_mm)
        return self

    @property
    def clear_radius_mm(self) -> float:
        """Radius round the ring's origin that holds the workspace at every angle of the stage."""
        if self.stage is None:
            return self.workspace.radius_mm
        most = math.radians(max(abs(angle) for angle in self.stage.range_deg))
        return self.workspace.radius_mm + 2 * math.hypot(*self.stage.centre_mm) * math.sin(
            min(most, math.pi) / 2
        )

    @property
    def emulated(self) -> bool:
        """Whether the devices are emulated rather than real."""
        return self.emulation is not None


def load_rig(source: Source) -> RigFile:
    """Read and check the rig described in `source`.

    Raises:
        InputError: unreadable, wrong keys or values, or parts of the rig that do not go together; one line.

    """
    return load_toml(source, RigFile, {})
