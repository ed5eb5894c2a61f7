"""What many simulations of one model give."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from spiral.types.record import Array


@dataclass(frozen=True, repr=False)
class Batch:
    """Noise-free motions of one model under many inputs, starts or values.

    Fields
    ----------
    time : (samples,) s.
    channels : readings by channel, (simulations, samples) each.
    states : states by name, those of effects too, (simulations, samples) each.
    slopes : d reading / d parameter, (simulations, samples, channels), by the parameters (and
        initial states) that were asked for.
    diverged : (simulations,) True where a state ran away (above 1e12, or no number); its numbers
        are NaN from there on.
    device : where they were integrated, as JAX calls it.
    """

    time: Array
    channels: Mapping[str, Array]
    states: Mapping[str, Array]
    diverged: Array
    device: str
    slopes: Mapping[str, Array] = field(default_factory=dict)

    @property
    def simulations(self) -> int:
        """Their number."""
        return len(self.diverged)

    @property
    def readings(self) -> Array:
        """(simulations, samples, channels) all channels."""
        return np.stack(list(self.channels.values()), axis=-1)

    @property
    def jacobian(self) -> Array:
        """(simulations, samples, channels, parameters) all slopes, in the order asked for."""
        if not self.slopes:
            return np.zeros((*self.readings.shape, 0))
        return np.stack(list(self.slopes.values()), axis=-1)

    def __repr__(self) -> str:
        ran = int(self.diverged.sum())
        told = f", {ran} of which ran away" if ran else ""
        return (
            f"Batch of {self.simulations} simulations{told}: {len(self.time)} samples of "
            f"{', '.join(self.channels)}, on {self.device}"
        )
