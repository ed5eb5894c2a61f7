"""From a problem to one study with its compiled model.

``strategy=shooting`` compiles all candidates with it; ``strategy=likelihood`` compiles only the
effects in the model and keeps its candidates uncompiled.

A candidate with a shape parameter is compiled once for each value of its grid; a candidate that
turns with the phase but has no direction of its own (an unbalance), while the model knows no phase
origin yet, is compiled with a companion a quarter turn ahead.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from spiral.engine.series import prepare_series, sample_inputs
from spiral.engine.study import ORIGIN, CompiledStudy, ParameterColumns, columns_for
from spiral.inference.evidence.excerpt import Excerpt
from spiral.inference.evidence.scales import (
    covering_samples,
    is_tried_scale,
    largest_port_motion,
    shape_scale,
    states_along_records,
)
from spiral.inference.evidence.spectral_lines import strongest_line
from spiral.inference.problem import Problem
from spiral.physics.compile import CompiledModel, compile_model
from spiral.physics.rest import check_rest, is_finite_along, undefined_effects_along
from spiral.physics.trace import trace
from spiral.types.effect import Effect
from spiral.types.label import owner_of, split_key
from spiral.types.model import Model
from spiral.types.parameter import Parameter
from spiral.types.port import Port
from spiral.types.record import Array, Record

NO_NUMBER = "it is not a number (0/0, overflow) along these records"


@dataclass(frozen=True)
class Variant:
    """One compiled copy of a candidate: its shapes, and its companion a quarter turn ahead.

    ``tuned`` are the shapes that a refit may set free (those with several values to try);
    ``searched`` the number of independent values among which this one was looked for; ``limits``,
    by full name, are values of shapes beyond which it is another effect (``Parameter.most``).
    """

    effect: Effect
    original: Effect
    shapes: Mapping[str, float]
    companion: Effect | None = None
    tuned: tuple[str, ...] = ()
    searched: int = 1
    limits: Mapping[str, float] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """The compiled label."""
        return self.effect.label


@dataclass(frozen=True)
class Assembly:
    """The problem with its compiled model (``study``).

    ``strategy=shooting`` compiles all candidates (``variants``); ``strategy=likelihood`` compiles
    only the effects in the model (``bare``) and keeps the candidates uncompiled in ``offered``,
    where they are scored by their signatures.

    ``left_out`` are candidates that these records cannot be asked about, and why; ``kept`` is what
    the strategy keeps with it, of a type of its own. ``expected`` are the states (samples, n)
    along each record that a fit's filter expects, from which candidates have the scales of their
    shapes. ``excerpt`` : the whole records, where these are stretches of such.
    """

    problem: Problem
    study: CompiledStudy
    variants: tuple[Variant, ...]
    kept: object = None
    left_out: Mapping[str, str] = field(default_factory=dict)
    offered: tuple[Variant, ...] = ()
    bare: bool = False
    expected: tuple[Array, ...] = ()
    excerpt: Excerpt | None = None

    @property
    def later(self) -> tuple[Effect, ...]:
        """Candidates that resonate, which are laid at what is left when a round calls for them."""
        return tuple(c for c in self.problem.candidates if resonates(c))

    def variant(self, label: str) -> Variant:
        """A variant by its compiled label."""
        return next(v for v in self.variants if v.label == label)


_OWN_STATES = "it has states of its own, which strategy=likelihood alone can try"


def assemble(problem: Problem, substeps: int = 1, more: tuple[Variant, ...] = ()) -> Assembly:
    """Trace and compile the model with all variants of all candidates, and prepare the records.

    Candidates with states of their own wait for their round; ``more`` are variants of such, with
    their shapes (``spiral.inference.strategies.shooting.resonances``). Candidates that are no
    numbers along the records are left out, by name: compiled in with the others they would make no
    numbers of all.
    """
    waiting = tuple(c for c in problem.candidates if c.states)
    variants, left_out, states = build_variants(problem, waiting)
    left_out |= {c.label: _OWN_STATES for c in waiting if not resonates(c)}
    variants += more
    assembly = compile_assembly(problem, variants, substeps)
    undefined = _undefined_candidates(assembly, states)
    if undefined:
        left_out |= dict.fromkeys(undefined, NO_NUMBER)
        kept = [v for v in variants if v.original.label not in undefined]
        assembly = compile_assembly(problem, kept, substeps)
    return replace(assembly, left_out=left_out)


def resonates(effect: Effect) -> bool:
    """Whether an effect has states of its own and a frequency that the records are searched for."""
    return bool(effect.states) and any(p.spectrum for p in effect.parameters)


def build_variants(
    problem: Problem, waiting: Sequence[Effect], expected: Sequence[Array] = ()
) -> tuple[list[Variant], dict[str, str], Sequence[Array]]:
    """Variants of all candidates but those that wait.

    Returns them with the candidates left out and why, and the states that the records visit.
    ``expected`` as in ``largest_port_motion``.
    """
    now = [c for c in problem.candidates if c not in waiting]
    states = states_along_records(problem.model, problem.records) if now else ()
    largest = (
        largest_port_motion(problem.model.system, problem.records, states, expected) if now else {}
    )
    variants: list[Variant] = []
    left_out: dict[str, str] = {}
    for candidate in now:
        copies = _candidate_variants(problem.model, candidate, largest, problem)
        variants += copies
        if not copies:
            left_out[candidate.label] = _untestable_reason(problem.model, candidate, largest)
    return variants, left_out, states


def compile_assembly(problem: Problem, variants: Sequence[Variant], substeps: int) -> Assembly:
    """One compiled study of the problem's model and these variants."""
    compiled, knot = compile_with_variants(problem, variants), problem.settings.phase_knot
    series = tuple(prepare_series(problem.model.system, r, substeps, knot) for r in problem.records)
    return Assembly(problem, CompiledStudy(compiled, series), tuple(variants))


def compile_with_variants(problem: Problem, variants: Sequence[Variant]) -> CompiledModel:
    """The problem's model and these variants, compiled."""
    model = problem.model
    effects = [*model.effects]
    shifts = [0.0] * len(effects)
    for variant in variants:
        effects.append(variant.effect)
        shifts.append(0.0)
        if variant.companion is not None:
            effects.append(variant.companion)
            shifts.append(np.pi / 2)
    compiled = compile_model(trace(model.system, tuple(effects), tuple(shifts)))
    check_rest(compiled, model.system, model.effects, problem.candidates, model.values)
    return compiled


def check_candidates(problem: Problem) -> None:
    """Trace and evaluate at rest what will not be compiled before it is admitted.

    Effects that come with the package are known to be traced; of hundreds of them at all places
    it would take as long as the first fit.

    Raises
    ------
    PluginError : a candidate that fails, or that is no number at rest.
    """
    model, unknown = problem.model, tuple(c for c in problem.candidates if not c.is_shipped())
    if unknown:
        compiled = compile_model(trace(model.system, (*model.effects, *unknown)))
        check_rest(compiled, model.system, model.effects, unknown, model.values)


def _undefined_candidates(assembly: Assembly, states: Sequence[Array]) -> tuple[str, ...]:
    """Candidates whose force or slopes are no numbers somewhere along the records."""
    study = assembly.study
    rows = initial_values(assembly)
    inputs = [sample_inputs(s.inputs, s.substeps) for s in study.series]
    for record, (x, u) in enumerate(zip(states, inputs, strict=False)):
        where = covering_samples(x)
        if is_finite_along(study.compiled, rows[record], x[where], u[where]):
            continue
        values = dict(zip(study.keys, rows[record], strict=False))
        effects = {v.effect.label: v.effect for v in assembly.variants}
        system = assembly.problem.model.system
        bad = undefined_effects_along(system, tuple(effects.values()), values, x[where], u[where])
        return tuple(dict.fromkeys(assembly.variant(x).original.label for x in bad))
    return ()


def _untestable_reason(model: Model, effect: Effect, largest: Mapping[str, float]) -> str:
    """Why these records cannot test an effect: no motion at its port, or too low a sample rate."""
    port = model.system.place(effect)
    for parameter in effect.parameters:
        size = shape_scale(parameter, largest, port)
        if parameter.grid and not is_tried_scale(parameter, size):
            return (
                f"nothing moves at {port.name} in these records: its {parameter.name} has no scale"
            )
    return "the sample rate of these records cannot show it"


def with_records(
    assembly: Assembly, records: tuple[Record, ...], substeps: int, knot: float = 0.0
) -> Assembly:
    """The same compiled model with other records, their phase corrected only where asked."""
    system = assembly.problem.model.system
    series = tuple(prepare_series(system, r, substeps, knot) for r in records)
    return replace(assembly, study=replace(assembly.study, series=series))


def with_steps(assembly: Assembly, substeps: int) -> Assembly:
    """The same study with so many integration steps per sample."""
    problem = assembly.problem
    return with_records(assembly, problem.records, substeps, problem.settings.phase_knot)


def _candidate_variants(
    model: Model, effect: Effect, largest: Mapping[str, float], problem: Problem
) -> list[Variant]:
    port = model.system.place(effect)
    shapes = [p for p in effect.parameters if p.role == "shape"]
    directed = any(e.undirected() for e in model.effects)
    companion = effect.undirected() and not directed
    variants = []
    for number, shares in enumerate(itertools.product(*(p.grid or (1.0,) for p in shapes))):
        tag = str(number + 1) if shapes else ""
        copy = replace(effect, variant=tag)
        tried = [
            _shape_trial(p, s, largest, port, problem) for p, s in zip(shapes, shares, strict=True)
        ]
        if not all(count for _, count in tried):
            continue
        keys = [f"{copy.label}.{p.name}" for p in shapes]
        sizes = {k: value for k, (value, _) in zip(keys, tried, strict=True)}
        free = (len(p.grid) != 1 and not p.choice for p in shapes)
        tuned = tuple(itertools.compress(keys, free))
        turned = replace(effect, variant=f"{tag}quarter") if companion else None
        searched = int(np.prod([count for _, count in tried]))
        limits = {
            k: p.most * shape_scale(p, largest, port)
            for k, p in zip(keys, shapes, strict=True) if p.most is not None
        }  # fmt: skip
        variants.append(Variant(copy, effect, sizes, turned, tuned, searched, limits))
    return variants


def _shape_trial(
    parameter: Parameter, share: float, largest: Mapping[str, float], port: Port, problem: Problem
) -> tuple[float, int]:
    """A shape's value and among how many it was looked for; 0 where the records cannot show it."""
    size = shape_scale(parameter, largest, port)
    value = share * size
    if parameter.grid and not is_tried_scale(parameter, size):
        return value, 0
    if not parameter.search:
        return value, 1
    return strongest_line(problem.records, value, parameter.search) or (value, 0)


# --- columns -------------------------------------------------------------------------------------


def active_keys(
    assembly: Assembly,
    labels: tuple[str, ...],
    freed: tuple[str, ...] = (),
    corrected: bool = True,
) -> tuple[str, ...]:
    """Parameters that a fit moves when these effects (compiled labels) are active."""
    model = assembly.problem.model
    movable = set(model.active)
    effects = effects_of(assembly, labels)
    turning = any("phase" in e.inputs for e in effects)
    corrections = assembly.study.correction_keys if corrected and turning else ()
    keys = []
    for key in assembly.study.keys:
        owner = owner_of(key)
        if key == ORIGIN:
            if ORIGIN in movable and any(e.undirected() for e in effects):
                keys.append(key)
        elif owner == "system" or owner in model.labels:
            if key in movable and (owner == "system" or owner in labels):
                keys.append(key)
        elif owner in labels and (key in freed or _parameter_role(assembly, key) == "amplitude"):
            keys.append(key)
    return (*keys, *corrections)


def nuisance_keys(assembly: Assembly, labels: tuple[str, ...]) -> tuple[str, ...]:
    """Parameters that belong to a record and that these effects depend on."""
    effects = effects_of(assembly, labels)
    traced = assembly.study.compiled.traced
    keys = []
    for key, parameter in zip(traced.keys, traced.parameters, strict=True):
        owner = owner_of(key)
        if parameter.scope != "record" or (owner != "system" and owner not in labels):
            continue
        if key == ORIGIN and not any("phase" in e.inputs for e in effects):
            continue
        keys.append(key)
    return tuple(keys)


def effects_of(assembly: Assembly, labels: Collection[str]) -> list[Effect]:
    """The effects behind compiled labels, the model's own first."""
    own = [e for e in assembly.problem.model.effects if e.label in labels]
    return own + [v.effect for v in assembly.variants if v.label in labels]


def _parameter_role(assembly: Assembly, key: str) -> str:
    return assembly.study.compiled.traced.parameters[assembly.study.index(key)].role


def columns_with_bounds(
    assembly: Assembly, keys: tuple[str, ...]
) -> tuple[ParameterColumns, tuple[Array, Array]]:
    """Columns with their bounds; the phase origin is shared where phase was measured."""
    study = assembly.study
    shared = all("phase" in s.record.measured for s in study.series)
    moving = columns_for(study, keys, shared)
    known = study.compiled.traced.parameters
    parameters = [known[i] if i < len(known) else None for i in moving.index]
    low = np.array([-np.inf if p is None or p.lower is None else p.lower for p in parameters])
    high = np.array([np.inf if p is None or p.upper is None else p.upper for p in parameters])
    return moving, (low, high)


def initial_values(assembly: Assembly) -> Array:
    """Values (records, parameters) known before any fit: given, starts, shapes; else zero."""
    study = assembly.study
    row = np.zeros(len(study.keys) + study.corrections)
    given = assembly.problem.model.values
    for i, (key, parameter) in enumerate(
        zip(study.keys, study.compiled.traced.parameters, strict=True)
    ):
        row[i] = given.get(key, parameter.start or 0.0)
    for variant in assembly.variants:
        for key, value in variant.shapes.items():
            row[study.index(key)] = value
            if variant.companion is not None:
                row[study.index(key.replace(variant.label, variant.companion.label))] = value
    return np.tile(row, (len(study.series), 1))


def unknown_keys(assembly: Assembly, keys: tuple[str, ...]) -> tuple[str, ...]:
    """Active parameters for which neither a value nor a start is known."""
    given = assembly.problem.model.values
    traced = assembly.study.compiled.traced
    starts = dict(zip(traced.keys, traced.parameters, strict=True))
    return tuple(k for k in keys if k not in given and k in starts and starts[k].start is None)


def with_model_values(
    assembly: Assembly, labels: tuple[str, ...], values: Array, model: Model
) -> Array:
    """A study's values with those of a fitted model in their columns, all others unchanged."""
    own = {"system", *labels}
    rename = {v.label: v.original.label for v in assembly.variants if v.label in own}
    new_values = values.copy()
    for column, key in enumerate(assembly.study.keys):
        owner, name = split_key(key)
        value = model.values.get(f"{rename.get(owner, owner)}.{name}")
        if owner in own and value is not None:
            new_values[:, column] = value
    return new_values


def to_model(
    assembly: Assembly,
    labels: tuple[str, ...],
    values: Array,
    errors: Mapping[str, float],
    freed: tuple[str, ...] = (),
    held: tuple[str, ...] = (),
    correlations: Mapping[str, Mapping[str, float]] | None = None,
) -> Model:
    """The model with the study's active effects and values, under its effects' real names.

    ``freed`` shapes move in later fits of it, ``held`` amplitudes do not; ``correlations`` are of
    the ``errors``.
    """
    model = assembly.problem.model
    chosen = [assembly.variant(x) for x in labels if x not in model.labels]
    rename = {v.label: v.original.label for v in chosen}
    effects = tuple(e for e in model.effects if e.label in labels)
    effects += tuple(v.original for v in chosen)

    def original_key(key: str) -> str:
        owner, name = split_key(key)
        return f"{rename.get(owner, owner)}.{name}"

    kept = {"system", *labels}
    row = dict(zip(assembly.study.keys, values[0], strict=False))  # corrections left out
    known = {original_key(k): float(v) for k, v in row.items() if owner_of(k) in kept}
    return replace(
        model,
        effects=effects,
        values=known,
        errors={original_key(k): float(v) for k, v in errors.items() if owner_of(k) in kept},
        correlations={
            original_key(k): {original_key(j): r for j, r in row.items() if owner_of(j) in kept}
            for k, row in (correlations or {}).items()
            if owner_of(k) in kept
        },
        freed=(*model.freed, *(original_key(k) for k in freed)),
        fixed=(*model.fixed, *(original_key(k) for k in held)),
    )
