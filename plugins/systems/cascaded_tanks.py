"""Two tanks, one above the other."""

from __future__ import annotations

from spiral_plugins.effects.flows import Outlets, Pump

from spiral.types.parameter import Input, State
from spiral.types.port import Port
from spiral.types.system import System


class CascadedTanks(System):
    """x1' = k u - k1 sqrt(x1), x2' = k1 sqrt(x1) - k2 sqrt(x2): the lower level x2 is measured.

    The upper level x1 is hidden. Its unit is that of the lower tank's sensor, by the assumption
    that both tanks are alike: what leaves the upper one raises the lower one by as much as it sank.
    """

    level_unit: str = "V"

    observed = ("lower",)
    parameters = ()
    seed = (Pump(), Outlets())

    @property
    def states(self):
        """Levels of the upper and lower tank."""
        return (State("upper", self.level_unit, like="lower"), State("lower", self.level_unit))

    @property
    def inputs(self):
        """The pump's voltage, held between samples."""
        return (Input("pump", "V", interpolation="zero_order"),)

    @property
    def injections(self):
        """Flows into the two tanks."""
        unit = f"{self.level_unit}/s"
        return (State("upper", unit), State("lower", unit))

    @property
    def ports(self):
        """The tanks, for units: levels and flows."""
        unit = self.level_unit
        return (Port("tanks", ("level",), lambda q, p: [q.lower], unit, f"{unit}/s"),)

    def rate(self, x, u, p, injected):
        """Each level changes by what flows in."""
        return dict(injected)
