"""Every plugin that is shipped passes the conformance suite, and broken ones do not."""

import pytest
from spiral_plugins.effects.restoring import GravityTorque
from spiral_plugins.sources.rotor_coastdown import RotorCoastdown
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.pendulum import Pendulum
from spiral_plugins.systems.planar_rotor import PlanarRotor

from spiral.io.testing import check_effect, check_plugin, check_source, check_system, failed
from spiral.math import sqrt
from spiral.types.effect import ForceEffect
from spiral.types.parameter import Parameter, State
from spiral.types.port import Port
from spiral.types.record import Record, make_record
from spiral.types.source import Source
from spiral.types.system import System
from tests.scenes import registry

REGISTRY = registry()
EFFECTS = [e for e in REGISTRY.entries if e.kind in ("system", "effect")]


def _param(entry):
    """Of the learned curves, whose many coefficients take long to trace, one; the rest are slow."""
    slow = entry.name.startswith("learned_") and entry.name != "learned_spring"
    marks = (pytest.mark.slow,) if slow else ()
    return pytest.param(entry, marks=marks, id=f"{entry.kind}-{entry.name}")


@pytest.mark.parametrize("entry", [_param(e) for e in EFFECTS])
def test_every_shipped_system_and_effect_passes(entry):
    checks = check_plugin(entry, REGISTRY)
    assert len(checks) >= 10
    assert not failed(checks)


KINDS = ("learner", "library", "gate", "observer", "strategy")
EVIDENCE = [e for e in REGISTRY.entries if e.kind in KINDS]


@pytest.mark.parametrize("entry", EVIDENCE, ids=[f"{e.kind}-{e.name}" for e in EVIDENCE])
def test_every_shipped_part_of_the_evidence_and_observer_passes(entry):
    checks = check_plugin(entry, REGISTRY)
    assert len(checks) >= 3
    assert not failed(checks)


@pytest.mark.parametrize("name", REGISTRY.names("source"))
def test_every_shipped_source_passes(name):
    source = REGISTRY.make("source", name)
    assert not failed(check_source(source, PlanarRotor()))
    assert not failed(check_source(source, Oscillator()))


def test_a_record_is_loaded_not_only_refused():
    seen = {c.name: c.seen for c in check_source(RotorCoastdown(duration=0.5), PlanarRotor())}
    assert seen["loads"] == "1 record of 500 samples"


def test_the_pendulum_is_one_short_file_about_the_sine_and_the_damper():
    with open(REGISTRY.entry("system", "pendulum").file) as file:
        assert len(file.readlines()) <= 50
    pendulum = Pendulum()
    assert [e.label for e in pendulum.seed] == ["linear_damping", "gravity_torque"]
    assert (pendulum.observed, pendulum.inputs[0].name) == (("theta",), "torque")
    assert not failed(check_system(Pendulum(torque_unit="N*m")))


class _Spring(ForceEffect):
    """A spring: F = -k q."""

    parameters = (Parameter("stiffness", "force/position"),)

    def force(self, at, u, p):
        return [-p.stiffness * q for q in at.position]


class Wordless(_Spring):
    pass


class WithoutEquation(_Spring):
    """A spring."""


class WrongUnit(_Spring):
    """A spring: F = -k q."""

    parameters = (Parameter("stiffness", "force"),)


class UnknownUnit(_Spring):
    """A spring: F = -k q."""

    parameters = (Parameter("stiffness", "force/positon"),)


class Infinite(_Spring):
    """Unit vector: F = -k q / |q|."""

    parameters = (Parameter("level", "force"),)

    def force(self, at, u, p):
        length = sqrt(sum(q * q for q in at.position))
        return [-p.level * q / length for q in at.position]


class Squared(_Spring):
    """Not linear: F = -(k / c)^2 c q."""

    parameters = (
        Parameter("stiffness", "force/position"),
        Parameter("scale", "force/position", role="shape", start=1.0),
    )

    def force(self, at, u, p):
        return [-(p.stiffness**2) / p.scale * q for q in at.position]


class AlwaysThere(_Spring):
    """Not absent: F = -(k + c) q."""

    parameters = (
        Parameter("stiffness", "force/position"),
        Parameter("rest", "force/position", role="shape", start=1.0),
    )

    def force(self, at, u, p):
        return [-(p.stiffness + p.rest) * q for q in at.position]


class Branching(_Spring):
    """An if: F = -k q for q > 0."""

    def force(self, at, u, p):
        return [-p.stiffness * q if q > 0 else 0 * p.stiffness * q for q in at.position]


class NoAmplitude(_Spring):
    """Only a shape: F = -k q."""

    parameters = (Parameter("stiffness", "force/position", role="shape", start=1.0),)


class LagWithoutRate(_Spring):
    """A lag: z' = (q - z) / T."""

    states = (State("lagged", "position", per_axis=True),)


class LagOfWrongUnit(LagWithoutRate):
    """A lag that forgets its time constant: z' = q - z."""

    def rate(self, at, u, p):
        return {"lagged": [q - z for q, z in zip(at.position, at.own.lagged, strict=True)]}


class Lag(LagWithoutRate):
    """A spring behind a lag: F = -k z, z' = (q - z) / T."""

    parameters = (
        Parameter("stiffness", "force/position"),
        Parameter("time_constant", "s", lower=0.0, start=0.01, role="shape"),
    )

    def force(self, at, u, p):
        return [-p.stiffness * z for z in at.own.lagged]

    def rate(self, at, u, p):
        pairs = zip(at.position, at.own.lagged, strict=True)
        return {"lagged": [(q - z) / p.time_constant for q, z in pairs]}


BROKEN = [
    (Wordless, "docstring"),
    (WithoutEquation, "docstring"),
    (WrongUnit, "units"),
    (UnknownUnit, "parameters"),
    (Infinite, "finite at rest"),
    (Squared, "linear in amplitudes"),
    (AlwaysThere, "absent at zero"),
    (Branching, "traces"),
    (NoAmplitude, "parameters"),
    (LagWithoutRate, "traces"),
    (LagOfWrongUnit, "units"),
]


@pytest.mark.parametrize(("effect", "name"), BROKEN, ids=[e.__name__ for e, _ in BROKEN])
def test_a_broken_effect_fails_the_check_that_is_about_it(effect, name):
    (found,) = failed(check_effect(effect(), PlanarRotor()))
    assert found.name == name
    assert found.seen
    assert found.try_


def test_a_sound_effect_passes_with_states_of_its_own():
    for effect in (_Spring(), Lag()):
        assert not failed(check_effect(effect, PlanarRotor()))
    assert "fits" in [c.name for c in failed(check_effect(GravityTorque(), PlanarRotor()))]


class WrongMass(Oscillator):
    """m x'' = force."""

    def mass(self, q, p):
        return [[-p.mass]]


class UnknownChannel(Oscillator):
    """m x'' = force."""

    observed = ("y",)


class SeedOfWrongUnit(Oscillator):
    """m x'' = force."""

    seed = (WrongUnit(),)


class ForceOfWrongUnit(Oscillator):
    """m x'' = force."""

    def force(self, q, v, u, p):
        return [u.force * q.x]


class Tank(System):
    """level' = inflow - k level, what effects add beside it."""

    states = (State("level", "m"),)
    observed = ("level",)
    inputs = ()
    seed = ()
    injections = (State("level", "m/s"),)
    parameters = (Parameter("k", "1/s", lower=0.0, start=0.1),)
    ports = (Port("tank", ("level",), lambda x, p: [x.level], "m", "m/s"),)

    def rate(self, x, u, p, injected):
        return {"level": injected["level"] - p.k * x.level}


class FlowOfWrongUnit(Tank):
    """level' = -k level; the flow in m."""

    injections = (State("level", "m"),)


class DeafToInjections(Tank):
    """level' = -k level and nothing else."""

    def rate(self, x, u, p, injected):
        return {"level": -p.k * x.level}


class RateForgotten(Tank):
    """level' = -k level, the settled mud forgotten."""

    states = (State("level", "m"), State("mud", "m"))


class RootOfAnything(Tank):
    """level' = -k sqrt(level), of levels below zero too."""

    parameters = (Parameter("k", "m^0.5/s", lower=0.0, start=0.1),)

    def rate(self, x, u, p, injected):
        return {"level": injected["level"] - p.k * sqrt(x.level)}


class Exploding(Oscillator):
    """m x'' = force + 1e6 x."""

    defaults = {
        "system.mass": 1.0,
        "linear_stiffness.stiffness": -1e12,
        "linear_damping.damping": -1e9,
    }


@pytest.mark.parametrize(
    ("system", "name"),
    [
        (WrongMass, "mass"),
        (UnknownChannel, "names"),
        (SeedOfWrongUnit, "units of the seed"),
        (ForceOfWrongUnit, "units of the equations"),
        (Exploding, "simulates"),
        (FlowOfWrongUnit, "units of the equations"),
        (DeafToInjections, "injections"),
        (RateForgotten, "traces"),
    ],
)
def test_a_broken_system_fails_the_check_that_is_about_it(system, name):
    assert [c.name for c in failed(check_system(system()))] == [name]


def test_a_root_that_may_be_of_something_negative_is_named_by_its_rate():
    (first, *_) = failed(check_system(RootOfAnything()))
    assert "rate of 'level' or a slope of it is not a number" in first.seen


class Crashing(Source):
    """Divides by zero."""

    def load(self, system):
        raise ZeroDivisionError("a defect")


class Restless(Source):
    """Other numbers each time."""

    drawn = []

    def load(self, system) -> tuple[Record, ...]:
        import numpy as np

        self.drawn.append(0)
        values = np.random.default_rng(len(self.drawn)).normal(size=(2, 100))
        channels = {"x": values[0]}
        return (
            make_record(system, "drawn", 0.01 * np.arange(100), channels, {"force": values[1]}),
        )


@pytest.mark.parametrize(("source", "name"), [(Crashing, "loads"), (Restless, "repeatable")])
def test_a_broken_source_fails_the_check_that_is_about_it(source, name):
    assert [c.name for c in failed(check_source(source(), Oscillator()))] == [name]
