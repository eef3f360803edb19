"""Taxel forces: what frames of a flat or free array say, taxel by taxel."""

from dataclasses import dataclass, fields

from palpate.base.geometry import Bools, Floats, Ints
from palpate.drivers.tactile.baseline import SIGMAS

__all__ = ["TaxelForces"]


@dataclass(frozen=True, eq=False)
class TaxelForces:
    """What n frames say, each (n, r, c): `force_n` above zero, 0 where not `usable`; `noise_n`: its standard
    deviation; `drift_n`: bound of what the zeros are off by; `full`: at the largest count. Full and dead
    taxels are not usable.
    """

    force_n: Floats
    noise_n: Floats
    drift_n: Floats
    usable: Bools
    full: Bools

    def frames(self, which: Ints) -> "TaxelForces":
        """Some of the frames."""
        return TaxelForces(**{f.name: getattr(self, f.name)[which] for f in fields(TaxelForces)})

    @property
    def doubt_n(self) -> Floats:
        """Less than this may be nothing."""
        result: Floats = SIGMAS * self.noise_n + self.drift_n
        return result
