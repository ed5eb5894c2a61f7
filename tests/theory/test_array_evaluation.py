"""What a device runs, checked with NumPy: expressions, and inputs between their samples."""

import numpy as np
import pytest
import scipy.special
import sympy as sp
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.planar_rotor import PlanarRotor
from spiral_plugins.systems.tilting_rotor import TiltingRotor

from spiral.engine.batch_inputs import lay_out_inputs
from spiral.engine.series import stage_inputs
from spiral.physics.array_evaluation import ArrayEvaluator
from spiral.physics.compile import compile_model
from spiral.physics.outside.program import CalledProgram
from spiral.physics.trace import trace
from spiral.types.errors import PluginError
from spiral.types.parameter import Input
from spiral.types.placement import input_columns
from spiral.types.record import make_record
from tests.scenes import effect, registry

A, B = (sp.Symbol(name, real=True) for name in "ab")


def evaluated(expression, a, b):
    return ArrayEvaluator(np, scipy.special.erf, {A: a, B: b}).value(sp.sympify(expression))


@pytest.mark.parametrize("system", [PlanarRotor(), TiltingRotor(), Oscillator()])
def test_every_effect_is_what_machine_code_makes_of_it(system):
    """All effects that fit, at once, to 1e-13 of the largest."""
    seed = {s.label for s in system.seed}
    others = [e for e in registry().candidates(system) if e.label not in seed]
    traced = trace(system, (*system.seed, *others))
    compiled, rng = compile_model(traced), np.random.default_rng(0)
    x, u, p = (rng.uniform(0.1, 1.0, (5, len(g))) for g in (traced.x, traced.u, traced.p))
    symbols = dict(zip((*traced.x, *traced.u, *traced.p), np.hstack([x, u, p]).T, strict=True))
    evaluator = ArrayEvaluator(np, scipy.special.erf, symbols)
    for function, expressions in ((compiled.rate_value, traced.rate),
                                  (compiled.output_value, traced.output)):  # fmt: skip
        mine = np.stack([np.broadcast_to(evaluator.value(e), 5) for e in expressions], axis=1)
        for row in range(5):
            wanted = np.zeros(len(expressions))
            function(x[row], u[row], p[row], wanted)
            np.testing.assert_allclose(mine[row], wanted, rtol=1e-12)


@pytest.mark.parametrize(
    ("expression", "function"),
    [
        (sp.atan2(A, B), np.arctan2),
        (sp.Max(A, B, 0.5), lambda a, b: np.maximum(np.maximum(a, b), 0.5)),
        (sp.Min(A, B), np.minimum),
        (sp.erf(A) + sp.sign(B - 0.5), lambda a, b: scipy.special.erf(a) + np.sign(b - 0.5)),
        (A**-3 + sp.sqrt(B), lambda a, b: a**-3.0 + np.sqrt(b)),
        (A**B + sp.E**B + sp.pi, lambda a, b: a**b + np.exp(b) + np.pi),
        (A**7 + sp.floor(3 * B), lambda a, b: a**7 + np.floor(3 * b)),
        (sp.Piecewise((A, sp.And(A > B, sp.Not(sp.Ne(B, B)))), (B, sp.Or(A <= 0, A < B)),
                      (0, True)), lambda a, b: np.where(a > b, a, b)),
    ],
)  # fmt: skip
def test_functions(expression, function):
    a, b = np.random.default_rng(1).uniform(0.1, 1.0, (2, 50))
    np.testing.assert_allclose(evaluated(expression, a, b), function(a, b), rtol=1e-14)


def test_where_no_piece_holds_there_is_no_number():
    assert np.isnan(evaluated(sp.Piecewise((A, A > 2)), np.ones(1), np.ones(1)))[0]


def test_what_array_libraries_lack_is_said():
    program = CalledProgram("car.fmu", ("f",), ("a",), None, np.zeros(1, np.int64), np.zeros(1), 0)
    with pytest.raises(PluginError, match=r"car\.fmu in a batch(.|\n)*spiral\.simulate"):
        evaluated(program.values([A])[0], 1.0, 1.0)
    with pytest.raises(PluginError, match=r"gamma in an equation(.|\n)*spiral\.math"):
        evaluated(sp.gamma(A), 1.0, 1.0)


class _Driven(Oscillator):
    """An oscillator whose force runs between its samples as it is told."""

    way: str = "smooth"

    @property
    def inputs(self):
        return (Input("force", "N", interpolation=self.way, derivative=True),)


@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize(
    "way", ["smooth", "band_limited", "linear", "denoised", "zero_order", "zero_order_2"]
)
def test_inputs_at_the_stages_are_those_of_single_records(way, shared):
    """All stages of all integration steps, to rounding; held inputs keep the old value."""
    system, substeps, rng = _Driven(way=way), 3, np.random.default_rng(2)
    time = 0.5 + np.arange(80) / 20
    forces = rng.normal(size=(3, 80)).cumsum(axis=1)
    names = input_columns(system)
    columns = lay_out_inputs(
        system, time, {"force": forces[1] if shared else forces}, substeps, names
    )
    record = make_record(system, "one", time, {"x": rng.normal(size=80)}, {"force": forces[1]})
    wanted = stage_inputs(system, record, substeps)
    for place, column in enumerate(columns):
        own = [p if p.ndim == 1 else p[:, 1] for p in column.parts]
        rows = [
            column.stage(tuple(part[k] for part in own), 2 * step + stage, 2 * substeps)
            for k in range(79) for step in range(substeps) for stage in range(3)
        ]  # fmt: skip
        rows.append(column.stage(tuple(part[-1] for part in own), 0, 2 * substeps))
        scale = np.abs(wanted[:, place]).max()
        np.testing.assert_allclose(rows, wanted[:, place], rtol=0, atol=1e-13 * scale)


def test_a_phase_that_nobody_measured_is_the_integral_of_speed():
    system, time = PlanarRotor(), np.arange(50) / 50
    speeds = np.array([[3.0], [5.0]]) * (1 + time)
    columns = lay_out_inputs(system, time, {"speed": speeds}, 2, ("phase",))
    phase = dict(zip(input_columns(system), columns, strict=True))["phase"]
    wanted = np.array([[3.0], [5.0]]) * (time + time**2 / 2)
    np.testing.assert_allclose(phase.parts[0], wanted.T, atol=1e-12)
    assert columns[0].parts == ()  # in no equation: not made


def test_effects_of_memory_are_evaluated_too():
    """A state of an effect's own is a symbol like the others."""
    traced = trace(Oscillator(), (*Oscillator().seed, effect("bouc_wen")))
    ones = dict.fromkeys((*traced.x, *traced.u, *traced.p), np.ones(2))
    for rate in traced.rate:
        assert np.all(np.isfinite(ArrayEvaluator(np, scipy.special.erf, ones).value(rate)))
