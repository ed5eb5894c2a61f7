"""Flows into, between and out of tanks, and a level sensor that clips.

Levels are in the unit of the level sensor. After M. Schoukens, P. Mattsson, T. Wigren, J.-P. Noel,
"Cascaded tanks benchmark combining soft and hard nonlinearities" (2016).
"""

from __future__ import annotations

from spiral_plugins.effects.restoring import WIDTH

from spiral.math import ramp, sqrt
from spiral.types.effect import FlowEffect, SensorEffect
from spiral.types.parameter import Parameter


class Pump(FlowEffect):
    """A pump that fills the upper tank: x1' = k u."""

    channels = ("upper",)
    inputs = ("pump",)
    parameters = (Parameter("gain", "1/s", lower=0.0, start=0.04),)

    def flow(self, x, u, p):
        """The flow k u into the upper tank."""
        return {"upper": p.gain * u.pump}


class Outlets(FlowEffect):
    """Holes in the bottom of both tanks: x1' = -k1 sqrt(x1), x2' = k1 sqrt(x1) - k2 sqrt(x2).

    Torricelli's law. The root is rounded off near an empty tank, x/(x^2 + w^2)^(1/4), so that a
    level may touch zero.
    """

    channels = ("upper", "lower")
    parameters = (
        Parameter("upper", "position^0.5/s", lower=0.0, start=0.05),
        Parameter("lower", "position^0.5/s", lower=0.0, start=0.05),
        Parameter("width", "position", lower=0.0, start=0.1, role="shape"),
    )

    def flow(self, x, u, p):
        """What leaves the upper tank enters the lower one."""
        down = p.upper * _rounded_root(x.upper, p.width)
        return {"upper": -down, "lower": down - p.lower * _rounded_root(x.lower, p.width)}


def _rounded_root(level, width):
    return level / sqrt(sqrt(level * level + width * width))


class Overflow(FlowEffect):
    """Above its rim the upper tank spills, and part of that falls into the lower one.

    x1' = ... - (lost + caught) (x1 - r)_+ and x2' = ... + caught (x1 - r)_+ for two tanks of one
    area, with the rim at r and the corner of (.)_+ rounded over +-w (``spiral.math.ramp``).
    """

    channels = ("upper", "lower")
    parameters = (
        Parameter("lost", "1/s", lower=0.0, upper=1.0),
        Parameter("caught", "1/s", lower=0.0, upper=1.0),
        Parameter("rim", "position", lower=0.0, role="shape", grid=(0.5, 0.6, 0.7, 0.8, 0.9, 1.0)),
        WIDTH,
    )

    def flow(self, x, u, p):
        """-(lost + caught) (x1 - r)_+ and +caught (x1 - r)_+."""
        above = ramp(x.upper - p.rim, p.width)
        return {"upper": -(p.lost + p.caught) * above, "lower": p.caught * above}


class SensorSaturation(SensorEffect):
    """A level sensor that follows less above its limit: y - s (y - l)_+, s = 1 a hard stop.

    The corner of (.)_+ is rounded over +-w (``spiral.math.ramp``).
    """

    channels = ("lower",)
    parameters = (
        Parameter("share", "", lower=0.0, upper=1.0),
        Parameter("limit", "position", lower=0.0, role="shape", grid=(0.9, 0.95, 0.98)),
        WIDTH,
    )

    def reading(self, y, at, u, p):
        """The reading y - s (y - l)_+."""
        return [value - p.share * ramp(value - p.limit, p.width) for value in y]
