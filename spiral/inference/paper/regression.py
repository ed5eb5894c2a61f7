"""Equations of motion as regression: z = sum_k theta_k phi_k, linear in every amplitude.

From the traced balance M q'' - F = 0: z is what has no unknown (the acceleration, where all is per
unit mass), phi_k the balance's derivative by an amplitude. An unbalance of unknown angle is the
pair U cos(phi_0), U sin(phi_0).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spiral.engine.series import sample_inputs
from spiral.engine.start import Balance, angle_groups, prepare_balance
from spiral.engine.study import ORIGIN
from spiral.inference.evidence.assembly import Assembly
from spiral.types.derivative import Derivative, differentiate
from spiral.types.errors import ConfigError
from spiral.types.placement import check_states
from spiral.types.record import Array


@dataclass(frozen=True)
class Samples:
    """Differentiated records, their ends left out, one after the other.

    ``states`` (N, n) coordinates and rates, ``inputs`` (N, m), ``acceleration`` (N, q), ``record``
    (N,) the number of the record, ``angle`` (N,) which records share a phase origin, ``dt`` in s.
    """

    states: Array
    inputs: Array
    acceleration: Array
    record: Array
    angle: Array
    dt: float


def differentiate_records(assembly: Assembly, derivative: Derivative) -> Samples:
    """Every record's coordinates, rates and accelerations by an estimator.

    Raises
    ------
    InputError : the estimator cannot serve a record. ConfigError : coordinates that no channel
        shows, as many as channels.
    """
    check_states(assembly.problem.model.system, "the paper's regression")
    traced = assembly.study.compiled.traced
    group = angle_groups(assembly.study)
    parts: list[list[Array]] = [[] for _ in range(5)]
    for number, series in enumerate(assembly.study.series):
        speed = series.record.inputs.get("speed")
        derivatives = differentiate(derivative, series.y, series.dt, speed)
        if derivatives.position.shape[1] != len(traced.channels):
            raise ConfigError(
                f"derivative={derivative.plugin_name()}, which gives "
                f"{derivatives.position.shape[1]} coordinates of {len(traced.channels)} channels",
                "one for each channel",
                "derivative=total_variation",
            )
        inner = derivatives.inner
        states = np.zeros((series.samples, len(traced.states)))
        acceleration = np.zeros((series.samples, len(traced.acceleration)))
        for channel, name in enumerate(traced.channels):
            states[:, traced.states.index(name)] = derivatives.position[:, channel]
            states[:, traced.states.index(traced.rate_name(name))] = derivatives.velocity[
                :, channel
            ]
            acceleration[:, traced.states.index(name)] = derivatives.acceleration[:, channel]
        count = len(states[inner])
        inputs = sample_inputs(series.inputs, series.substeps)[inner]
        for part, values in zip(
            parts,
            (states[inner], inputs, acceleration[inner], np.full(count, number),
             np.full(count, group[number])),
            strict=True,
        ):  # fmt: skip
            part.append(values)
    whole = [np.concatenate(p) for p in parts]
    return Samples(*whole, dt=assembly.study.series[0].dt)


@dataclass(frozen=True)
class Equations:
    """The regression of one study, ready to be evaluated.

    ``keys`` are amplitudes in order; ``turning`` the one whose force turns with the phase origin
    (an unbalance whose angle is fitted), or empty.
    """

    keys: tuple[str, ...]
    turning: str
    origin: int | None
    parts: Balance

    def evaluate(
        self, states: Array, inputs: Array, acceleration: Array, row: Array, shift: float = 0.0
    ) -> tuple[Array, Array]:
        """Columns (N, C, K) and target z (N, C) at N points.

        ``row`` holds the parameters' values (shapes, and the phase origin, to which ``shift`` is
        added); amplitudes do not matter.
        """
        known = row.copy()
        if self.origin is not None:
            known[self.origin] += shift
        given = (*states.T, *inputs.T, *known[list(self.parts.used)], *acceleration.T)
        count, rows = len(states), self.parts.rows
        columns = np.empty((count, rows * len(self.keys)))
        for j, values in enumerate(self.parts.columns(*given)):
            columns[:, j] = values
        target = np.empty((count, rows))
        for j, values in enumerate(self.parts.rest(*given)):
            target[:, j] = values
        return -columns.reshape(count, rows, len(self.keys)), target


def regression_equations(assembly: Assembly, keys: tuple[str, ...]) -> Equations:
    """Prepare the regression on these amplitudes.

    Raises
    ------
    ConfigError : a system whose coordinates are not all measured, or an amplitude that does not
        enter linearly.
    """
    study = assembly.study
    traced = study.compiled.traced
    try:
        parts = prepare_balance(study, traced, keys)
    except ConfigError as error:
        raise ConfigError(
            f"strategy=paper with system {assembly.problem.model.system.plugin_name()!r}",
            "a mechanical system whose coordinates are all measured, so that they can be "
            "differentiated",
            "strategy=shooting, or the observable system (planar_rotor for tilting_rotor)",
        ) from error
    turning = ""
    if ORIGIN in traced.keys and ORIGIN in assembly.problem.model.active:
        turning = next(
            (f"{e.label}.{e.amplitudes()[0].name}" for e in assembly.problem.model.effects
             if e.undirected()), "",
        )  # fmt: skip
    origin = study.index(ORIGIN) if ORIGIN in traced.keys else None
    return Equations(keys, turning if turning in keys else "", origin, parts)


def design_matrix(regression: Equations, samples: Samples, values: Array) -> tuple[Array, Array]:
    """Columns (N, C, K + extra) and target (N, C) of all samples.

    ``values`` (records, parameters). The turning column is replaced by its pair: K + ``extra``
    columns, the (cos, sin) pairs of every group of angles last (see ``column_names``).
    """
    columns = np.empty((len(samples.states), regression.parts.rows, len(regression.keys)))
    target = np.empty(columns.shape[:2])
    for number in np.unique(samples.record):
        at = samples.record == number
        columns[at], target[at] = regression.evaluate(
            samples.states[at], samples.inputs[at], samples.acceleration[at], values[number]
        )
    if not regression.turning:
        return columns, target
    position = regression.keys.index(regression.turning)
    groups = np.unique(samples.angle)
    pairs = np.zeros((*columns.shape[:2], 2 * len(groups)))
    still = values[0].copy()
    still[regression.origin] = 0.0
    for index, group in enumerate(groups):
        at = samples.angle == group
        given = samples.states[at], samples.inputs[at], samples.acceleration[at], still
        for half, shift in enumerate((0.0, np.pi / 2)):
            pairs[at, :, 2 * index + half] = regression.evaluate(*given, shift)[0][..., position]
    return np.concatenate([np.delete(columns, position, axis=2), pairs], axis=2), target


def column_names(regression: Equations, samples: Samples) -> tuple[str, ...]:
    """Names of the columns of ``design_matrix``; a pair is ``KEY cos`` and ``KEY sin``."""
    if not regression.turning:
        return regression.keys
    names = [k for k in regression.keys if k != regression.turning]
    groups = np.unique(samples.angle)
    for group in groups:
        mark = f" {group}" if len(groups) > 1 else ""
        names += [f"{regression.turning} cos{mark}", f"{regression.turning} sin{mark}"]
    return tuple(names)


def with_coefficients(
    regression: Equations, samples: Samples, values: Array, names: tuple[str, ...], b: Array, study
) -> Array:
    """Values (records, parameters) with a fit's coefficients; pairs become angle and size."""
    new = values.copy()
    pairs: list[float] = []
    for name, value in zip(names, b, strict=True):
        if regression.turning and name.startswith(f"{regression.turning} "):
            pairs.append(float(value))
        else:
            new[:, study.index(name)] = value
    if pairs:
        cosine, sine = np.array(pairs).reshape(-1, 2).T
        new[:, study.index(regression.turning)] = np.sqrt(np.mean(cosine**2 + sine**2))
        group = {int(r): int(a) for r, a in zip(samples.record, samples.angle, strict=True)}
        order = sorted(set(group.values()))
        for record in range(len(new)):
            at = order.index(group[record])
            new[record, regression.origin] = np.arctan2(sine[at], cosine[at])
    return new
