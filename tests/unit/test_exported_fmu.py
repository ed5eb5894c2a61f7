"""An exported FMU is valid, describes the model, and runs as we do, in both of its ways."""

import shutil

import numpy as np
import pytest

import spiral
from spiral.engine.kernel import trajectories
from spiral.engine.series import rows_at_stages
from spiral.physics.compile import compile_model
from spiral.types.errors import ConfigError
from spiral.types.units import base_form
from tests.exported import (
    STEP,
    SUBSTEPS,
    TIME,
    doubles,
    hostile_model,
    machine_of,
    same,
)

fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
if shutil.which("gcc") is None:
    pytest.skip("no gcc here", allow_module_level=True)


@pytest.fixture(scope="module", params=["hysteresis", "rotor"])
def machine(request):
    return machine_of(request.param)


@pytest.fixture(scope="module")
def archive(machine, tmp_path_factory):
    return spiral.export(machine.model, "fmu", tmp_path_factory.mktemp("fmu") / "model.fmu")


@pytest.fixture(scope="module")
def description(archive):
    return fmpy.read_model_description(str(archive))


@pytest.fixture(scope="module")
def folder(archive):
    return fmpy.extract(str(archive), str(archive.with_suffix("")))


def opened(machine, description, folder, kind):
    """An instance ready to run from the machine's first state, and its value references by name."""
    from fmpy.fmi2 import FMU2Model, FMU2Slave

    known = {v.name: v.valueReference for v in description.modelVariables}
    own = {"FMU2Model": FMU2Model, "FMU2Slave": FMU2Slave}[kind](
        guid=description.guid, unzipDirectory=folder, instanceName="own",
        modelIdentifier=description.coSimulation.modelIdentifier,
    )  # fmt: skip
    own.instantiate()
    own.setupExperiment(startTime=0.0)
    own.setReal([known[n] for n in machine.start], list(machine.start.values()))
    own.enterInitializationMode()
    own.exitInitializationMode()
    return own, known


def test_it_is_valid_and_describes_the_model(machine, archive, description):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(archive)) == []
    variables = {v.name: v for v in description.modelVariables}
    model = machine.model
    for key, error in {**dict.fromkeys(model.values), **model.errors}.items():
        found = variables[key]
        assert float(found.start) == model.values[key]
        assert found.unit == (model.unit(key) or None)
        words = "no standard error" if error is None else f"standard error {error}"
        assert found.description == words
    assert [v.unit for v in description.modelVariables if v.causality == "output"] == [
        model.system.unit_of(c) for c in model.system.observed
    ]


def test_model_exchange_runs_as_we_do(machine, description, folder):
    own, _ = opened(machine, description, folder, "FMU2Model")
    own.enterContinuousTimeMode()
    n, grid = len(machine.states[0]), machine.grid
    inputs = [v.valueReference for v in description.modelVariables if v.causality == "input"]
    outputs = [v.valueReference for v in description.modelVariables if v.causality == "output"]
    values, rates = np.empty(n), np.empty(n)

    def at(x, row):
        values[:] = x
        own.setTime(row[-1])
        own.setContinuousStates(doubles(values), n)
        own.setReal(inputs, row[:-1].tolist())
        own.getDerivatives(doubles(rates), n)
        return rates.copy()

    x, states, readings = machine.states[0].copy(), [], []
    for k in range(SUBSTEPS * (len(TIME) - 1)):
        a, b, c = grid[3 * k : 3 * k + 3]
        k1 = at(x, a)
        if k % SUBSTEPS == 0:
            states.append(x)
            readings.append(own.getReal(outputs))
        k2 = at(x + STEP / 2 * k1, b)
        k3 = at(x + STEP / 2 * k2, b)
        x = x + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + at(x + STEP * k3, c))
    same(np.array(states), machine.states[:-1])
    same(np.array(readings), machine.readings[:-1])
    own.terminate()
    own.freeInstance()


@pytest.mark.parametrize("finer", [1, 3])
def test_co_simulation_runs_as_we_do_along_straight_inputs(machine, description, folder, finer):
    own, known = opened(machine, description, folder, "FMU2Slave")
    own.setReal([known["integration_step"]], [STEP / finer if finer > 1 else 0.0])
    inputs = [v.valueReference for v in description.modelVariables if v.causality == "input"]
    rows, samples = machine.grid[::3], 60
    found = []
    for k in range(samples):
        found.append(own.getReal(list(range(len(machine.states[0])))))
        own.setReal(inputs, rows[k, :-1].tolist())
        slopes = (rows[k + 1, :-1] - rows[k, :-1]) / STEP
        own.setRealInputDerivatives(inputs, [1] * len(inputs), slopes.tolist())
        own.doStep(rows[k, -1], STEP)
    own.terminate()
    own.freeInstance()
    share = np.arange(2 * finer * samples + 1) / (2 * finer)
    straight = np.column_stack(
        [np.interp(share, np.arange(len(rows)), column) for column in rows.T]
    )
    same(np.array(found), free_run(machine, np.ascontiguousarray(straight), finer, samples))


def free_run(machine, grid, substeps, samples):
    """Our own states, one communication step a sample, along a grid of half steps."""
    compiled = compile_model(machine.traced)
    states, readings = np.empty((samples, len(machine.states[0]))), np.empty((samples, 2))
    readings = readings[:, : machine.readings.shape[1]].copy()
    trajectories(
        compiled.rate_value, compiled.output_value, machine.states[:1].copy(),
        np.zeros(1, dtype=np.int64), np.array([samples]), machine.model.row("", "")[None],
        rows_at_stages(grid), substeps, STEP, states, readings,
    )  # fmt: skip
    return states


def test_directional_derivatives_are_the_exact_jacobians(machine, description, folder):
    own, _ = opened(machine, description, folder, "FMU2Model")
    x, u = machine.point
    references = {k: [v.valueReference for v in description.modelVariables if v.causality == k]
                  for k in ("input", "output", "parameter")}  # fmt: skip
    states = list(range(len(x)))
    rates = [len(x) + s for s in states]
    own.setReal([*states, *references["input"]], [*x, *u[:-1]])
    own.setTime(u[-1])

    def slopes(unknown, known):
        columns = [own.getDirectionalDerivative(unknown, [k], [1.0]) for k in known]
        return np.array(columns).T

    parameters = references["parameter"][:-1]  # the last one is the step of co-simulation
    wanted = machine.jacobians
    for unknown, one, other in ((rates, *wanted[:2]), (references["output"], *wanted[2:])):
        same(slopes(unknown, states), one)
        same(slopes(unknown, parameters), other)
    found, small = slopes(rates, references["input"]), 1e-6
    for j in range(len(u) - 1):
        move = small * np.eye(len(u))[j]
        ahead, behind = machine.values(x, u + move)[0], machine.values(x, u - move)[0]
        numeric = (ahead - behind) / (2 * small)
        np.testing.assert_allclose(found[:, j], numeric, rtol=1e-5, atol=1e-5)
    own.freeInstance()


def test_fmi_3_runs_as_we_do(machine, tmp_path):
    """Valid; co-simulation under held inputs; both kinds of exact derivatives."""
    from fmpy.fmi3 import FMU3Slave
    from fmpy.validation import validate_fmu

    file = spiral.export(machine.model, "fmu3", tmp_path / "model.fmu")
    assert validate_fmu(str(file)) == []
    found = fmpy.read_model_description(str(file))
    own = FMU3Slave(
        guid=found.guid, unzipDirectory=fmpy.extract(str(file), str(tmp_path / "x")),
        instanceName="own", modelIdentifier=found.coSimulation.modelIdentifier,
    )  # fmt: skip
    own.instantiate()
    known = {v.name: v.valueReference for v in found.modelVariables}
    inputs = [v.valueReference for v in found.modelVariables if v.causality == "input"]
    states, samples, held = list(range(len(machine.states[0]))), 40, machine.grid[9]
    own.enterInitializationMode()
    own.setFloat64(states, machine.states[0].tolist())
    own.setFloat64(inputs, held[:-1].tolist())
    own.setFloat64([known["integration_step"]], [STEP / 2])
    own.exitInitializationMode()
    run = []
    for k in range(samples):
        assert own.getFloat64([known["time"]]) == pytest.approx([k * STEP], abs=1e-12)
        run.append(own.getFloat64(states))
        own.doStep(k * STEP, STEP)
    time = STEP / 4 * np.arange(4 * samples + 1)
    grid = np.column_stack([np.tile(held[:-1], (len(time), 1)), time])
    same(np.array(run), free_run(machine, grid, 2, samples))
    rates = [len(states) + s for s in states]
    forward = [own.getDirectionalDerivative(rates, [k], [1.0], len(rates)) for k in states]
    backward = [own.getAdjointDerivative([r], states, [1.0], len(states)) for r in rates]
    assert np.any(forward)
    np.testing.assert_allclose(np.transpose(forward), backward)
    own.terminate()
    own.freeInstance()


@pytest.mark.parametrize("machine", ["hysteresis"], indirect=True)
def test_a_state_is_kept_and_taken_up_again(machine, description, folder):
    own, _ = opened(machine, description, folder, "FMU2Slave")
    kept = own.getFMUState()
    written = own.serializeFMUState(kept)
    before = own.getReal([0])
    own.doStep(0.0, STEP)
    after = own.getReal([0])
    own.setFMUState(own.deserializeFMUState(written))
    assert own.getReal([0]) == before
    own.doStep(0.0, STEP)
    assert own.getReal([0]) == after
    own.freeFMUState(kept)
    own.freeInstance()


@pytest.mark.parametrize("kind", ["fmu", "fmu3"])
def test_a_hostile_name_is_a_text_in_the_description(kind, tmp_path):
    from fmpy.validation import validate_fmu

    file = spiral.export(hostile_model(), kind, tmp_path / "model.fmu")
    assert validate_fmu(str(file)) == []
    names = [v.name for v in fmpy.read_model_description(str(file)).modelVariables]
    assert any("evil()" in name and '"' not in name for name in names)


@pytest.mark.parametrize(
    ("unit", "base"),
    [
        ("mN/um", (1e3, {"kg": 1, "s": -2})),
        ("degC", (1.0, {"K": 1})),
        ("rad/s", (1.0, {"rad": 1, "s": -1})),
        ("V^0.5/s", None),
        ("count", None),
        ("dB", None),
    ],
)
def test_units_have_their_base_form(unit, base):
    found = base_form(unit)
    assert found == (base and (pytest.approx(base[0]), base[1]))


def test_without_a_compiler_it_is_refused(monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(ConfigError, match="without a C compiler"):
        spiral.export(hostile_model(), "fmu", "model.fmu")
