"""Kinds of randomness about a machine and its sensors (``spiral.engine.likelihood.noise``)."""

from __future__ import annotations

from typing import Literal

Kind = Literal["white", "coloured", "band", "vibration", "drift", "force", "gust"]

COLOURED: tuple[Kind, ...] = ("coloured", "band", "vibration")
"""Kinds of noise that a sensor has all the time, and that is not white."""
