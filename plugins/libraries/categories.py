"""The paper's categories (table CandidateLibrary) as effects, named ones where there are any."""

from __future__ import annotations

from dataclasses import dataclass

from spiral_plugins.effects import bare, dissipative, restoring, rotating

from spiral.types.effect import Effect
from spiral.types.errors import ConfigError
from spiral.types.library import Term
from spiral.types.system import System
from spiral.types.units import units_fit


@dataclass(frozen=True)
class Category:
    """One row of the table: the effects that span it, each with its physical origin."""

    name: str
    effects: tuple[tuple[type[Effect], str], ...]


CONSTANT = Category("constant", ((restoring.ConstantLoad, "bias, constant load"),))
LINEAR = Category(
    "linear",
    (
        (restoring.LinearStiffness, "observable self-coupling: stiffness"),
        (dissipative.LinearDamping, "observable self-coupling: damping"),
        (restoring.CrossStiffness, "cross-channel stiffness, direct or mediated by the tilt"),
        (restoring.CrossCoupledStiffness, "circulatory cross-channel stiffness"),
        (dissipative.CrossDamping, "cross-channel damping, direct or mediated by the tilt"),
        (dissipative.AntisymmetricDamping, "antisymmetric cross-channel damping"),
    ),
)
QUADRATIC = Category(
    "quadratic",
    (
        (restoring.QuadraticStiffness, "weak geometric nonlinearity"),
        (bare.QuadraticCoupling, "weak geometric nonlinearity across channels"),
    ),
)
POSITION_VELOCITY = Category(
    "quadratic displacement-velocity",
    ((bare.PositionVelocity, "state coupling and nonlinear damping"),),
)
VELOCITY = Category(
    "quadratic velocity", ((bare.VelocityProducts, "velocity-dependent nonlinearity"),)
)
SPEED = Category("speed coupling", ((bare.SpeedCoupling, "speed-dependent stiffness"),))
GYROSCOPIC = Category(
    "gyroscopic",
    (
        (dissipative.Gyroscopic, "gyroscopic moment of the hidden tilt"),
        (bare.SpeedDamping, "speed-proportional damping, not gyroscopic"),
    ),
)
DUFFING = Category(
    "Duffing nonlinear stiffness",
    (
        (restoring.CubicStiffness, "isotropic Duffing stiffness of the bearings"),
        (bare.UnevenCubic, "cubic stiffness that is not isotropic"),
    ),
)
DAMPING = Category(
    "nonlinear damping",
    (
        (dissipative.AmplitudeDamping, "amplitude-dependent damping"),
        (bare.UnevenDamping, "amplitude-dependent damping that is not isotropic"),
    ),
)
IMBALANCE = Category(
    "imbalance forcing",
    (
        (rotating.Unbalance, "rotating mass imbalance"),
        (bare.BackwardUnbalance, "synchronous forcing against the rotation"),
    ),
)

TABLE = (
    CONSTANT, LINEAR, QUADRATIC, POSITION_VELOCITY, VELOCITY, SPEED, GYROSCOPIC, DUFFING, DAMPING,
    IMBALANCE,
)  # fmt: skip


def expand_categories(categories: tuple[Category, ...], system: System) -> tuple[Term, ...]:
    """A term for every amplitude of every effect that fits the system."""
    terms = []
    for category in categories:
        for kind, mechanism in category.effects:
            effect = kind()
            if not fits_system(system, effect):
                continue
            terms += [
                Term(effect, key, category.name, mechanism)
                for key, p in effect.keys(system.port())
                if p.role == "amplitude"
            ]
    return tuple(terms)


def fits_system(system: System, effect: Effect) -> bool:
    """Whether the system has the axes, inputs and units that an effect needs."""
    from spiral.types.placement import check_effect

    try:
        check_effect(system, effect)
    except ConfigError:
        return False
    return units_fit(system, effect)
