"""An epidemic in several towns under changing contacts: the infectious are counted.

All groups are shares of the population; the recovered are what is left of it.
"""

from __future__ import annotations

from spiral.types.effect import FlowEffect
from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import System


class Contagion(FlowEffect):
    """S' = -b k S I, E' = + b k S I, k the measured contacts."""

    channels = ("susceptible", "exposed", "infectious")
    inputs = ("contacts",)
    parameters = (Parameter("rate", "1/s", lower=0.0),)

    def flow(self, x, u, p):
        """-b k S I and + b k S I."""
        caught = p.rate * u.contacts * x.susceptible * x.infectious
        return {"susceptible": -caught, "exposed": caught}


class CourseOfDisease(FlowEffect):
    """E' = -s E, I' = s E - g I."""

    channels = ("exposed", "infectious")
    parameters = (Parameter("onset", "1/s", lower=0.0), Parameter("recovery", "1/s", lower=0.0))

    def flow(self, x, u, p):
        """-s E and s E - g I."""
        ill = p.onset * x.exposed
        return {"exposed": -ill, "infectious": ill - p.recovery * x.infectious}


class WaningImmunity(FlowEffect):
    """The recovered become susceptible again: S' = w (1 - S - E - I)."""

    channels = ("susceptible", "exposed", "infectious")
    parameters = (Parameter("rate", "1/s", lower=0.0),)

    def flow(self, x, u, p):
        """w (1 - S - E - I)."""
        return {"susceptible": p.rate * (1 - x.susceptible - x.exposed - x.infectious)}


class Importation(FlowEffect):
    """Travellers bring the disease: E' = i."""

    channels = ("exposed", "infectious")
    parameters = (Parameter("rate", "1/s", lower=0.0),)

    def flow(self, x, u, p):
        """i."""
        return {"exposed": p.rate}


class Caution(FlowEffect):
    """Fewer contacts where many are ill: S' = + c S I^2, E' = - c S I^2."""

    channels = ("susceptible", "exposed", "infectious")
    parameters = (Parameter("rate", "1/s", lower=0.0),)

    def flow(self, x, u, p):
        """+ c S I^2 and - c S I^2."""
        spared = p.rate * x.susceptible * x.infectious**2
        return {"susceptible": spared, "exposed": -spared}


class Vaccination(FlowEffect):
    """Susceptible people leave their group: S' = -v S."""

    channels = ("susceptible", "infectious")
    parameters = (Parameter("rate", "1/s", lower=0.0),)

    def flow(self, x, u, p):
        """-v S."""
        return {"susceptible": -p.rate * x.susceptible}


class Epidemic(System):
    """S' = -b k S I, E' = b k S I - s E, I' = s E - g I (after Kermack, McKendrick 1927)."""

    states = (State("susceptible", ""), State("exposed", ""), State("infectious", ""))
    observed = ("infectious",)
    inputs = (Input("contacts", "", "zero_order"),)
    injections = tuple(State(n, "1/s") for n in ("susceptible", "exposed", "infectious"))
    parameters = ()
    ports = (Port("town", ("infectious",), lambda x, p: [x.infectious], "", "1/s"),)
    seed = (Contagion(), CourseOfDisease())

    def rate(self, x, u, p, injected):
        """Each group changes by who comes and goes."""
        return dict(injected)
