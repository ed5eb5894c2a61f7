"""Models that exports are tried with, and how they run here: what every export must repeat."""

import ctypes
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from spiral.engine.series import stage_inputs
from spiral.inference.simulate import integrate
from spiral.io.registry import load_registry
from spiral.physics.compile import compile_model
from spiral.physics.trace import trace
from spiral.types.model import Model, seed_model
from spiral.types.record import make_record

REGISTRY = load_registry(local=False)
CLOSE = 1e-8
TIME = 0.01 * np.arange(80)
SUBSTEPS = 4
STEP = (TIME[1] - TIME[0]) / SUBSTEPS
SHAKEN = {"force": np.random.default_rng(1).normal(size=len(TIME))}
SPEED = {"speed": 60 - 30 * TIME, "phase": 60 * TIME - 15 * TIME**2}
PUMPED = {"pump": 2 + np.sign(np.sin(9 * TIME))}
FULL = {"upper": 3.0, "lower": 0.9}
MACHINES = {  # an effect with states of its own and a shifted sensor; corners; a rotor; tanks
    "hysteresis": ("oscillator", ("bouc_wen", "offset"), SHAKEN, {"x": 0.3}),
    "corners": ("oscillator", ("clearance", "coulomb_friction"), SHAKEN, {"x": 1.5}),
    "rotor": ("planar_rotor", ("gyroscopic", "crack"), SPEED, {"x": 1e-3}),
    "tanks": ("cascaded_tanks", ("overflow", "sensor_saturation"), PUMPED, FULL),
}
EVIL = '"; import os \\\n*/ evil() /* \'\'\'"""\r\u2028 %} ??/ \\input{evil} <evil> ]]> $(evil)'


@dataclass(frozen=True)
class Machine:
    """A model with inputs, a start, and the free run that they make here."""

    model: Model
    inputs: dict
    start: dict
    states: np.ndarray
    readings: np.ndarray

    @property
    def traced(self):
        return trace(self.model.system, self.model.effects)

    @property
    def grid(self):
        """Inputs and time at the stages of all steps, then at the last sample."""
        system = self.model.system
        quiet = dict(zip(system.observed, self.readings.T, strict=True))
        frame = make_record(system, "planned", TIME, quiet, self.inputs)
        return stage_inputs(system, frame, SUBSTEPS)

    @property
    def point(self):
        """A state, and the inputs with time behind them, at which values are compared."""
        return self.states[7] + 0.01, np.linspace(0.4, 1.3, len(self.traced.inputs))

    def values(self, x, u):
        """f and h as the fit uses them."""
        compiled, p = compile_model(self.traced), self.model.row("", "")
        rates, readings = np.empty(len(x)), np.empty(len(self.traced.channels))
        compiled.rate_value(x, u, p, rates)
        compiled.output_value(x, u, p, readings)
        return rates, readings

    @property
    def jacobians(self):
        """f_x, f_p, h_x, h_p at the point as the fit uses them."""
        traced, (x, u) = self.traced, self.point
        compiled, p = compile_model(traced), self.model.row("", "")
        found = []
        for function, rows in ((compiled.rate, len(x)), (compiled.output, len(traced.channels))):
            by_x, by_p = np.zeros((rows, len(x))), np.zeros((rows, len(p)))
            function(x, u, p, np.empty(rows), by_x, by_p)
            found += [by_x, by_p]
        return found


@cache
def machine_of(kind):
    """One of ``MACHINES``; its first parameter has a standard error."""
    name, effects, inputs, start = MACHINES[kind]
    found = tuple(map(REGISTRY.effect_from_label, effects))
    model = seed_model(REGISTRY.make("system", name), found)
    values = {k: 0.2 + 0.1 * i for i, (k, _) in enumerate(model.pairs)}
    model = replace(model, values=values, errors={next(iter(values)): 0.01})
    return Machine(model, inputs, start, *integrate(model, TIME, inputs, start, SUBSTEPS))


@cache
def hostile_model():
    """A model as a run.json of anyone may name its parts: a label that holds code."""
    effect = REGISTRY.effect_from_label("cubic_stiffness", {"variant": EVIL})
    model = seed_model(REGISTRY.make("system", "oscillator"), (effect,))
    return replace(model, values={k: 1.0 for k, _ in model.pairs})


def same(found, wanted):
    """Equal to 1e-8 of the largest value."""
    scale = np.abs(wanted).max() or 1.0
    found = np.asarray(found).reshape(wanted.shape)
    np.testing.assert_allclose(found / scale, wanted / scale, atol=CLOSE, rtol=0)


def doubles(array):
    """An array as C sees it."""
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
