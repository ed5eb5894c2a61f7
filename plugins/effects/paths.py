"""How a state acts on another: late, where something has to get from one to the other first.

The rate of a state is a function f(.., v, ..) of another one, its driver v. An effect on that path
puts another value w in its place there, and there alone: x' = ... + f(.., w, ..) - f(.., v, ..).
"""

from __future__ import annotations

from spiral_plugins.effects.late import SCALE, DelayedValue, lag_contradiction, late_by

from spiral.types.effect import StateFlow
from spiral.types.parameter import Parameter, State


class PathDelay(DelayedValue, StateFlow):
    """What a state does to another arrives late by T: w = v(t - T).

    A pipe between two vessels, a belt, a nerve, a signal on its way from one part to the next. By
    four states: Pade's second approximation of T / 2, twice (Baker, Graves-Morris, Pade
    Approximants), right in phase to (2 pi f T)^5 / 11520 at the frequency f. Where all that sensors
    see of the driver comes along this path, and it has one input, a late input looks the same.
    """

    driver = "path"
    twins = ("path_lag", "delay", "input_delay")

    def flow(self, at, u, p):
        """f(w) - f(v)."""
        return [at.along_path(self.late_value(at, p))]


class PathLag(StateFlow):
    """What a state does to another passes a store on its way: w = a, T a' = v - a.

    A mixing volume, a wall, a chamber between two vessels, a first-order low-pass. Its state
    follows in a time z near T, z a' = v - a and w = v - T / z (v - a), so that with z = T it is a,
    exactly; with another z it is right to the first order in T. It differs from a ``path_delay`` in
    the second order alone, which slow motion does not show.
    """

    driver = "path"
    states = (State("level", "position", like="position"),)
    twins = ("path_delay", "sensor_lag", "actuator_lag")
    whole = {"time": "scale"}
    parameters = (Parameter("time", "s", lower=0.0), SCALE)

    def flow(self, at, u, p):
        """f(w) - f(v)."""
        (given,) = at.position
        return [at.along_path(given - p.time / p.scale * (given - at.own.level))]

    def rate(self, at, u, p):
        """(v - a) / z."""
        return {"level": (at.position[0] - at.own.level) / p.scale}

    def limit_values(self, values):
        """A delay of the same time."""
        return late_by([values["time"]])

    def contradiction(self, fitted):
        """With T near 2 z it is Pade's first approximation of a delay of T, and no lag."""
        return lag_contradiction(fitted, "what arrives")
