"""The main jobs as functions, for notebooks and programs: records and models in, results out.

A plugin is given by its name (``"oscillator"``), by its name with fields (``{"name": "oscillator",
"position_unit": "V"}``), or as an object. Wherever a system is expected, a fitted ``Model`` or a
``Run`` is accepted too: the step then starts from its effects and values.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from spiral.inference.problem import Problem, Progress, Settings
from spiral.io import problem_setup
from spiral.io.export.kinds import export as export
from spiral.io.registry import Registry, load_registry
from spiral.types.effect import Effect
from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.fields import construct
from spiral.types.model import Model
from spiral.types.record import Array, Record
from spiral.types.run import Comparison, Diagnosis, Run, require_run
from spiral.types.system import System

if TYPE_CHECKING:
    import pandas as pd

    from spiral.inference.identifiability.identify import Identification
    from spiral.inference.plan import Plan
    from spiral.inference.reconstruction.estimate import Estimation
    from spiral.types.batch import Batch

Named = str | Mapping[str, Any]
Physics = Named | System | Model | Run
Records = Record | Sequence[Record]
Plugins = str | Path | Registry | None


# --- records -------------------------------------------------------------------------------------


def read(
    path: str | Path | Sequence[str] | Mapping[str, Any] | pd.DataFrame,
    system: Physics,
    *,
    plugins: Plugins = None,
    **fields: Any,
) -> Any:
    """A record from a file or a table, or a tuple of records from several files of one machine.

    Parameters
    ----------
    path : a file, several files, a DataFrame, series by name (``{"t": t, "x": x, "F": F}``), or any
        source by its name with fields, for instance the embedded run-down of a rotor:
        ``{"name": "rotor_coastdown", "seed": 11}``.
    system : whose channels and inputs the columns are.
    fields : as ``record.NAME`` on the command line: ``time`` or ``rate``, ``channels``, ``inputs``,
        ``units``, ``rows``, ``noise``, ``offset``, ``resample``, ...

    Raises
    ------
    SpiralError : a file, a column or a field that cannot be used.
    """
    from spiral.io.readers.frames import NAME, is_frame, refuse_array, table_of

    registry, given = _registry(plugins), cast("Any", path)
    refuse_array(given)
    single = isinstance(path, str | Path | Mapping) or is_frame(path)
    several, parts = not single, [given] if single else list(given)
    made = _system(system, registry)
    if parts and all(map(is_frame, parts)):
        source = registry.make("source", "file", {"path": NAME, **fields}, "record")
        tables = [table_of(part, fields.get("decimal") or ".") for part in parts]
        records = [r for table in tables for r in source.records_of(made, table, NAME)]
    elif isinstance(given, Mapping):
        records = _plugin("source", {**given, **fields}, registry).load(made)
    else:
        files = [str(p) for p in parts] if several else str(given)
        records = registry.make("source", "file", {"path": files, **fields}, "record").load(made)
    return tuple(records) if several or len(records) > 1 else records[0]


def simulate(
    system: Physics,
    duration: float,
    rate: float,
    *,
    inputs: Mapping[str, Any] | None = None,
    values: Mapping[str, float] | None = None,
    effects: Sequence[str | Effect] = (),
    noise_level: float = 0.0,
    seed: int = 0,
    start: Mapping[str, float] | None = None,
    plugins: Plugins = None,
) -> Record:
    """A record of a model: its motion under inputs, with white noise of known size.

    Parameters
    ----------
    duration, rate : s, and samples per s.
    inputs : input -> its samples in the system's unit, or a description such as
        ``{"noise": 1.0, "band": [5, 60]}`` or ``{"sweep": [40, 0], "unit": "Hz"}``.
    noise_level : standard deviation of the noise as a share of each channel's; ``seed`` draws it.

    Raises
    ------
    ConfigError : a parameter without a value, an unknown input or state, a motion that runs away.
    """
    import numpy as np

    from spiral.inference.excitation import excite
    from spiral.inference.simulate import simulate as integrated

    registry = _registry(plugins)
    truth = _model(system, registry, effects, values)
    time = np.arange(round(duration * rate)) / rate
    drawn, noise = np.random.default_rng(seed).spawn(2)
    known = {i.name: i for i in truth.system.inputs}
    series: dict[str, Array] = {}
    for name, wanted in (inputs or {}).items():
        if name not in known:
            raise ConfigError(
                f"input {name!r}", f"one of {', '.join(known) or 'none'}", did_you_mean(name, known)
            )
        described = isinstance(wanted, Mapping)
        series[name] = (
            excite(name, wanted, time, known[name].unit, drawn)
            if described
            else np.broadcast_to(np.asarray(wanted, float), time.shape).copy()
        )
    return integrated(truth, time, series, noise_level, noise, start)


def simulate_batch(
    system: Physics,
    duration: float,
    rate: float,
    *,
    inputs: Mapping[str, Any] | None = None,
    values: Mapping[str, Any] | None = None,
    effects: Sequence[str | Effect] = (),
    start: Mapping[str, Any] | None = None,
    slopes: Sequence[str] = (),
    device: str | None = None,
    plugins: Plugins = None,
) -> Batch:
    """Many noise-free motions of a model at once, by JAX: on a graphics card, or on processors.

    Each is the motion that ``simulate`` gives, in double precision, by eight integration steps a
    sample: of a stiff model, for which ``simulate`` takes more, it runs away (``diverged``). Needs
    the extra ``gpu``.

    Parameters
    ----------
    duration, rate : s, and samples per s.
    inputs : input -> (samples,) for all alike, or (simulations, samples), in the system's unit.
    values, start : parameters by full name, initial states: a number, or one for each simulation.
    slopes : parameters, and states whose starts are meant, that readings are differentiated by.
    device : ``cpu``, ``gpu``, ``gpu:1``; left out, JAX's first.

    Raises
    ------
    ConfigError : JAX or the device is absent, an unknown name, shapes that do not fit.
    PluginError : an equation that JAX cannot run, as of an FMU.
    """
    import numpy as np

    from spiral.inference.simulate_batch import simulate_batch as step

    model = _model(system, _registry(plugins), effects)
    time = np.arange(round(duration * rate)) / rate
    return step(model, time, inputs or {}, values, start, slopes, device)


# --- the main job --------------------------------------------------------------------------------


def compare(record: Records, system: Physics, **choices: Any) -> Comparison:
    """Fit a model as it is, and compare it with data that the fit never saw.

    ``choices`` : as in ``discover``, except candidates and strategy.
    """
    from spiral.inference.compare import compare as step

    with _progress_context(choices) as progress:
        return step(_problem(record, system, choices), progress)


def diagnose(record: Records, system: Physics, **choices: Any) -> Diagnosis:
    """Say where a model fails, and rank what may be missing; ``choices`` as in ``discover``."""
    from spiral.inference.diagnose import diagnose as step

    with _progress_context(choices) as progress:
        return step(_problem(record, system, choices), progress)


def discover(record: Records, system: Physics, **choices: Any) -> Run:
    """Find the effects that a model is missing, one round after another, until no candidate passes.

    Parameters
    ----------
    record : one record, or several of one machine.
    system : name, object, or a model or run to go on from.
    choices :
        ``effects`` beside the seed's, ``without`` effects of the seed, ``values`` by full name,
        ``free`` and ``fixed`` parameters (``fixed`` by name, or with values); ``test`` records, or
        the share ``holdout`` of the end that is kept apart (left out, a fifth, or up to half where
        that hardly moves), of each of ``holdout_blocks`` stretches (1);
        ``settle`` seconds of the test to which only its initial state and phase are fitted;
        ``candidates`` (names, at every place where they fit; ``NAME@PLACE``, or effects, there
        alone; left out, all that fit);
        ``strategy`` (a name, a name with options, or an object); ``settings`` (fields of
        ``Settings``); ``plugins`` (a folder, or a registry); ``progress`` (a function that is
        called with progress messages, ``False`` for none).

    Raises
    ------
    SpiralError : a choice that is unknown or cannot be.
    """
    from spiral.inference.discover import discover as loop

    with _progress_context(choices) as progress:
        problem = _problem(record, system, choices)
        return replace(loop(problem, progress), question=problem)


def add(run: Run, *effects: str | Effect, **choices: Any) -> tuple[Comparison, Comparison, Run]:
    """Fit a run's model without and with effects of your choice; returns both and the new run.

    ``choices`` : as in ``discover``; the records are the run's own.

    Raises
    ------
    ConfigError : no effect, one that the model has, or a run whose records are not at hand.
    """
    from spiral.inference.discover import add as step

    if not effects:
        raise ConfigError("add without an effect", "spiral.add(run, EFFECT, ...)")
    registry = _registry(choices.pop("plugins", None))
    with _progress_context(choices) as progress:
        asked = _problem_of_run(run)
        problem = replace(asked, model=run.model)
        wanted = tuple(registry.effect_from_label(e) if isinstance(e, str) else e for e in effects)
        for effect in wanted:
            if effect.label in problem.model.labels:
                raise ConfigError(
                    f"add {effect.label}, which the model has",
                    f"an effect it has not; it has {', '.join(problem.model.labels)}",
                )
        before, after, made = step(problem, wanted, progress)
        return before, after, replace(made, question=problem)


# --- what else a record and a model tell ----------------------------------------------------------


def estimate(
    model: Physics,
    record: Records,
    observer: Named | Any = "ekf",
    uncertain: Mapping[str, Any] | None = None,
    **choices: Any,
) -> Estimation:
    """Reconstruct all states, hidden ones too, with their uncertainty.

    Parameters
    ----------
    observer : ``ekf``, ``ukf``, ... by name, with fields, or as an object.
    uncertain : what is not known exactly, by name or pattern, as a standard deviation over the
        value (of an angle: rad): ``{"bearing.*": 0.2}``; or ``{NAME: {"absolute": 3}}``. Where it
        is left out, a fitted model's standard errors enter the bands; ``{}`` takes its values as
        exact.
    """
    from spiral.inference.reconstruction.estimate import estimate as step

    registry = _registry(choices.pop("plugins", None))
    with _progress_context(choices) as progress:
        _reject_unknown_choices(choices, "estimate")
        known, records = _model(model, registry), _records(record)
        chosen = _plugin("observer", observer, registry)
        models = (known,) * len(records)
        between = model.final.between if isinstance(model, Run) else None
        return step(models, records, chosen, progress, uncertain=uncertain, between=between)


def identify(
    record: Records, system: Physics, derivative: Named | Any = "total_variation", **choices: Any
) -> Identification:
    """Judge before any fit whether a record can distinguish the model's terms and candidates."""
    from spiral.inference.identifiability.identify import identify as step

    registry = _registry(choices.get("plugins"))
    with _progress_context(choices) as progress:
        problem = _problem(record, system, choices)
        return step(problem, _plugin("derivative", derivative, registry), progress)


def plan(run: Run, *effects: str | Effect, plugins: Plugins = None, **wishes: Any) -> Plan:
    """Rank planned tests that would distinguish effects, or reach a wanted standard error.

    Parameters
    ----------
    effects : two or more to tell apart; none where ``parameter`` is asked about.
    wishes : what a test may vary (``durations``, ``rates``, ``speeds``, ``amplitudes``, ``bands``);
        ``parameter`` and ``standard_error``; ``progress``.
    """
    from spiral.inference.plan import PlanQuestion
    from spiral.inference.plan import plan as step
    from spiral.inference.plan_options import plan_options
    from spiral.inference.planned_tests import planned_tests, simulator

    registry = _registry(plugins)
    with _progress_context(wishes) as progress:
        chosen, problem = plan_options(wishes), replace(_problem_of_run(run), model=run.model)
        wanted = tuple(registry.effect_from_label(e) if isinstance(e, str) else e for e in effects)
        asked = PlanQuestion(wanted, chosen.parameter or "", chosen.standard_error)
        tests = planned_tests(problem, chosen)
        return step(problem, asked, tests, simulator(problem, registry.simulation), progress)


# --- results out ---------------------------------------------------------------------------------


def report(run: Run, path: str | Path = "report.html") -> Path:
    """Write the report of a run as one HTML file: figures, tables, caveats; returns its path."""
    from spiral.io.writing import write_whole
    from spiral.view.plot import run_curves, saved_form
    from spiral.view.report.html import report_page

    target = Path(path).expanduser()
    html, _ = report_page(saved_form(run), run_curves(run))
    write_whole(target, html)
    return target


def load(run: str = "latest", folder: str | Path = "runs", *, plugins: Plugins = None) -> Model:
    """The final model of a run that the command line or the page has saved.

    Parameters
    ----------
    run : ``latest``, its id, or the start of its id. folder : of saved runs.
    """
    from spiral.io.storage import load_run

    return load_run(run, str(folder)).model(_registry(plugins))


# --- arguments -----------------------------------------------------------------------------------


_MODEL = ("effects", "values", "without", "free", "fixed")
_ASKED = ("test", "holdout", "holdout_blocks", "settle", "candidates", "strategy")


def _problem(record: Records, physics: Physics, choices: dict[str, Any]) -> Problem:
    """The ``Problem`` that a function's arguments describe."""
    registry, records = _registry(choices.pop("plugins", None)), _records(record)
    own = {k: choices.pop(k) for k in _MODEL if k in choices}
    asked = {k: choices.pop(k) for k in _ASKED if k in choices}
    levels = choices.pop("settings", {})
    _reject_unknown_choices(
        choices, "a study", (*_MODEL, *_ASKED, "settings", "plugins", "progress")
    )
    if not isinstance(levels, Settings | Mapping):
        known = "{'max_rounds': 3}"
        raise ConfigError(f"settings={levels!r}", f"values by name, such as {known}")
    settings = levels if isinstance(levels, Settings) else construct(Settings, levels, "settings")
    test = asked.pop("test", None)
    if "strategy" in asked:
        asked["strategy"] = _plugin("strategy", asked["strategy"], registry)
    return problem_setup.pose_problem(
        registry, _model(physics, registry, **own), records,
        None if test is None else _records(test), settings=settings, **asked,
    )  # fmt: skip


def _reject_unknown_choices(
    choices: Mapping[str, Any], what: str, known: Sequence[str] = ("plugins", "progress")
) -> None:
    for name in choices:
        hint = did_you_mean(name, known)
        if name == "seed" and "effects" in known:  # what the command line calls them
            hint = "effects=[...] begins with these effects"
        raise ConfigError(f"{name}= of {what}", f"one of {', '.join(known)}", hint)


def _registry(given: Plugins) -> Registry:
    return given if isinstance(given, Registry) else load_registry(given)


def _records(given: Records) -> tuple[Record, ...]:
    """One record or several.

    Raises
    ------
    ConfigError : what is none: a system where the arguments were exchanged, the path of a file.
    """
    from spiral.io.readers.frames import is_frame

    one_or_more: Any = given
    single = isinstance(given, Record | str | Mapping) or is_frame(given)
    if single or not isinstance(given, Iterable):
        one_or_more = (given,)
    records = tuple(one_or_more)
    for one in records:
        if not isinstance(one, Record):
            raise ConfigError(
                f"a {type(one).__name__} where a record belongs",
                "a Record or several, as spiral.read gives them",
                "the record first, then the system: spiral.discover(record, system); "
                'a file or a DataFrame: spiral.read("FILE", system)',
            )
    return records


def _plugin(kind: str, given: Any, registry: Registry) -> Any:
    """A plugin by name, by name with fields, or as the object that it is."""
    if isinstance(given, str):
        return registry.make(kind, given)
    if isinstance(given, Mapping):
        fields = {k: v for k, v in given.items() if k != "name"}
        return registry.make(kind, str(given.get("name")), fields)
    return given


def _system(given: Physics, registry: Registry) -> System:
    if isinstance(given, Run):
        return given.model.system
    made = given.system if isinstance(given, Model) else _plugin("system", given, registry)
    if not isinstance(made, System):
        raise ConfigError(
            f"a {type(made).__name__} where a system belongs",
            "a system's name, the file of its equations, or what spiral.system(...) makes",
        )
    return made


def _model(
    given: Physics,
    registry: Registry,
    effects: Sequence[str | Effect] = (),
    values: Mapping[str, float] | None = None,
    without: Sequence[str] = (),
    free: Sequence[str] = (),
    fixed: Sequence[str] | Mapping[str, float] = (),
) -> Model:
    """The model to start from: a system's seed or a given model, with the caller's changes."""
    from spiral.inference.simulate import with_defaults
    from spiral.types.model import seed_model

    if isinstance(given, Run):
        model = given.model
    elif isinstance(given, Model):
        model = given
    else:
        model = seed_model(_system(given, registry))
    for label in _listed(without):
        model = model.without(label)
    for effect in _listed(effects):
        model = model.add(registry.effect_from_label(effect) if isinstance(effect, str) else effect)
    given_values = {**(values or {}), **(fixed if isinstance(fixed, Mapping) else {})}
    model = replace(
        model, values={**model.values, **given_values},
        errors={k: e for k, e in model.errors.items() if k not in given_values},
        freed=(*model.freed, *_listed(free)), fixed=(*model.fixed, *_listed(fixed)),
    )  # fmt: skip
    return with_defaults(model)


def _listed(given: Any) -> Sequence[Any]:
    """One or several: a name or an effect alone is a list of one."""
    return (given,) if isinstance(given, str | Effect) else tuple(given)


def _problem_of_run(run: Run) -> Problem:
    """The ``Problem`` (records, model, candidates) that a run was made from.

    Raises
    ------
    ConfigError : a run that was not made in this process.
    """
    if require_run(run).question is None:
        raise ConfigError(
            "a run without its records", "one that spiral.discover made here", "discover again"
        )
    return run.question


def _progress_context(choices: dict[str, Any]) -> AbstractContextManager[Progress]:
    """Progress messages as the caller wants them: to a function, on a line, or dropped."""
    from spiral.view.progress import progress_for

    return progress_for(choices.pop("progress", None))
