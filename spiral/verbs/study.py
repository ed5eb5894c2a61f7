"""What each verb of the command line does: a request in, an outcome out, nothing printed.

The same functions serve the terminal, ``--json`` and the workers of a sweep.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from spiral.errors import ConfigError, SpiralError

if TYPE_CHECKING:
    from spiral.config import Config
    from spiral.model import Model
    from spiral.problem import Problem
    from spiral.record import Record
    from spiral.registry import Registry
    from spiral.run import Comparison, Round, Run

    Records = tuple[Record, ...]

OK, BAD_INPUT, REFUSED = 0, 2, 3

OnRound = Callable[["Round"], None]


@dataclass(frozen=True)
class Request:
    """What was asked: a verb, names (effects, kinds), overrides, and where plugins lie."""

    verb: str
    names: tuple[str, ...] = ()
    overrides: tuple[str, ...] = ()
    plugins: str | None = None
    out: str | None = None


@dataclass(frozen=True)
class Outcome:
    """What came of it.

    ``result`` is the JSON contract's; ``parts`` are the objects that the terminal draws, by name.
    """

    exit: int
    result: dict[str, Any]
    parts: dict[str, Any] = field(default_factory=dict)


Tell = Callable[[str], None]


def perform(request: Request, tell: Tell, on_round: OnRound | None = None) -> Outcome:
    """Carry out one request.

    Raises
    ------
    SpiralError : bad input; the caller makes it exit 2.
    """
    from spiral.custom import bound
    from spiral.registry import load_registry
    from spiral.verbs import estimate, foresight, plugins, report

    if request.verb == "new":
        return plugins.new(request)
    if request.verb == "report":
        return report.report(request, tell)
    registry = load_registry(request.plugins)
    if request.verb == "plugins":
        return plugins.list_plugins(request, registry)
    if request.verb == "check":
        return plugins.check(request, registry, tell)
    for failure in registry.failures:
        tell(f"not usable: {failure.name} in {failure.file}: {failure.message}")
    config = configured(request, registry)
    registry = bound(config, registry)
    steps = {
        "discover": _discover, "compare": _compare, "diagnose": _diagnose, "add": _add,
        "estimate": estimate.reconstruct, "identify": foresight.identify,
        "plan": foresight.plan,
    }  # fmt: skip
    if request.verb == "simulate":
        return _simulate(request, config, registry)
    if request.names and request.verb not in ("add", "plan"):
        raise ConfigError(
            f"{request.verb} {' '.join(request.names)}",
            f"{request.verb} with overrides KEY=VALUE",
            f"spiral add {request.names[0]}, or effect=[{request.names[0]}]",
        )
    tell("reading the records")
    study = Study(request, config, registry, tell, on_round)
    return report.with_curves(study, steps[request.verb])


def in_worker(
    verb: str, names: tuple[str, ...], overrides: tuple[str, ...], plugins: str | None
) -> tuple[int, dict[str, Any]]:
    """A request as a job of a sweep: exit code and result."""
    try:
        outcome = perform(Request(verb, names, overrides, plugins), lambda message: None)
    except SpiralError as error:
        return BAD_INPUT, {"error": error.as_dict()}
    return outcome.exit, outcome.result


def configured(request: Request, registry: Registry) -> Config:
    """The composed configuration, on top of a saved run where ``run=`` names one."""
    from spiral.config import compose
    from spiral.overrides import parse
    from spiral.storage import load_run
    from spiral.tracking.store import tracking_of

    given = {".".join(i.path): i.value for i in parse(request.overrides)}
    if not given.get("run"):
        config = compose(request.overrides, registry)
        tracking_of(config)  # refused before anything is computed
        return config
    saved = load_run(str(given["run"]), str(given.get("out") or "runs"))
    base = saved.as_config()
    if request.verb == "simulate":
        base = _as_truth(base, registry)
    kept = tuple(o for o in request.overrides if not o.startswith("run="))
    return {**compose(kept, registry, base), "run": saved.run_id}


def _records_of(problem: Problem) -> dict[str, Records]:
    return {"records": problem.records, "test": problem.test}


@dataclass(frozen=True)
class Study:
    """A request with its composed configuration; the problem is built when a verb asks."""

    request: Request
    config: Config
    registry: Registry
    tell: Tell
    on_round: OnRound | None

    def problem(self) -> Problem:
        """Records loaded, test kept apart."""
        from spiral.config import build_problem

        return build_problem(self.config, self.registry)

    def saved(self, run: Run, problem: Problem) -> Run:
        """The run with its id, written to the folder of runs."""
        return replace(run, run_id=self.save(run.as_dict(), run.model, problem))

    def save(self, result: Mapping[str, Any], model: Model, of: Problem | Records) -> str:
        """Write a result with its model to the folder of runs; returns the run's id."""
        from spiral.storage import save_result

        data = {"records": of} if isinstance(of, tuple) else _records_of(of)
        verb, out, given = self.request.verb, self.config["out"], self.request.overrides
        return save_result(verb, result, model, self.config, data, self.registry, out, given)

    def parts(self, problem: Problem, **more: Any) -> dict[str, Any]:
        """What the terminal needs besides the result."""
        return {"problem": problem, "request": self.request, "config": self.config, **more}


def _discover(study: Study) -> Outcome:
    problem = study.problem()
    run = study.saved(_through_the_loop(study, problem), problem)
    result = run.as_dict()
    refused = run.stopped in ("not_identifiable", "diverged")
    if refused:
        result["error"] = _refusal(run.stopped, run.advice)
    return Outcome(REFUSED if refused else OK, result, study.parts(problem, run=run))


def _through_the_loop(study: Study, problem: Problem) -> Run:
    """The loop, its rounds kept on disk, from where an unfinished study stopped."""
    from spiral.checkpoint import keeper
    from spiral.discover import discover

    with keeper(study.config, problem, study.registry, study.config["out"]) as kept:
        last = kept.last()
        if last is not None:
            study.tell(f"taking up this study, left unfinished in round {len(last.rounds)}")
        run = discover(problem, study.tell, study.on_round, kept.keep, last)
        kept.done()
    return run


def _compare(study: Study) -> Outcome:
    from spiral.compare import compare
    from spiral.screen.preview import described

    problem = study.problem()
    comparison = compare(problem, study.tell)
    result = {**comparison.as_dict(), "records": described(problem)}
    result["run_id"] = study.save(result, comparison.model, problem)
    if not comparison.converged:
        result["error"] = _not_converged(comparison)
    code = OK if comparison.converged else REFUSED
    return Outcome(code, result, study.parts(problem, comparison=comparison))


def _diagnose(study: Study) -> Outcome:
    from spiral.diagnose import diagnose

    problem = study.problem()
    diagnosis = diagnose(problem, study.tell)
    result = diagnosis.as_dict()
    result["run_id"] = study.save(result, diagnosis.comparison.model, problem)
    refused = diagnosis.verdict == "not_identifiable" or diagnosis.diverged
    if refused:
        reason = "diverged" if diagnosis.diverged else diagnosis.verdict
        result["error"] = _refusal(reason, diagnosis.advice)
    return Outcome(REFUSED if refused else OK, result, study.parts(problem, diagnosis=diagnosis))


def _add(study: Study) -> Outcome:
    from spiral.discover import add
    from spiral.run import estimates_dict

    if not study.request.names:
        raise ConfigError("add without an effect", "spiral add EFFECT...", "spiral plugins effect")
    problem = study.problem()
    effects = tuple(study.registry.effect_from_label(n) for n in study.request.names)
    for effect in effects:
        if effect.label in problem.model.labels:
            raise ConfigError(
                f"add {effect.label}, which the model has",
                f"an effect it has not; it has {', '.join(problem.model.labels)}",
                f"at another port: {effect.plugin_name()}@PORT",
            )
    before, after, run = add(problem, effects, study.tell)
    run = study.saved(run, problem)
    result = {
        "before": before.as_dict(),
        "after": after.as_dict(),
        "model": estimates_dict(run.model),
        "run_id": run.run_id,
    }
    if not after.converged:
        result["error"] = _not_converged(after)
    parts = study.parts(problem, before=before, after=after, run=run)
    return Outcome(OK if after.converged else REFUSED, result, parts)


def _refusal(verdict: str, advice: str) -> dict[str, str]:
    given = {
        "not_identifiable": "a record in which the model's effects look alike",
        "diverged": "a model whose motion runs away from the record",
    }[verdict]
    expected = {
        "not_identifiable": "excitation that tells them apart",
        "diverged": "a model near enough to follow the record",
    }[verdict]
    return {"given": given, "expected": expected, "try": advice}


def _not_converged(comparison: Comparison) -> dict[str, str]:
    return {
        "given": f"a fit that does not converge on windows of {comparison.horizon} samples",
        "expected": "a model near enough to follow the record",
        "try": "spiral diagnose with the same overrides, or first values: values='{NAME: VALUE}'",
    }


def _as_truth(base: Config, registry: Registry) -> Config:
    """A saved run's model as what ``record=simulation`` integrates."""
    from spiral.fields import defaults_of

    fields = defaults_of(registry.entry("source", "simulation").plugin)
    seeded = [e.label for e in registry.make("system", base["system"]["name"]).seed]
    labels = [*base["seed"], *base["effect"]]
    record = {
        "name": "simulation",
        **fields,
        "effects": [
            {"name": label, **base["effect"].get(label, {})}
            for label in labels
            if label not in seeded
        ],
        "without": [label for label in seeded if label not in labels],
        "values": dict(base["values"]),
    }
    return {**base, "record": record, "test": {"name": None, "settle": None}}


def _simulate(request: Request, config: Config, registry: Registry) -> Outcome:
    from spiral.config import build_sources, build_system
    from spiral.tables import write_record

    if not request.out:
        raise ConfigError("simulate without a file to write", "--out FILE.csv or FILE.parquet")
    system = build_system(config, registry)
    source, _ = build_sources({**config, "test": {"name": None}}, registry)
    records = source.load(system)
    written = [
        write_record(record, system, request.out, i if len(records) > 1 else None)
        for i, record in enumerate(records)
    ]
    result = {"files": [w.as_dict() for w in written], "read_back": list(written[0].read_back)}
    return Outcome(OK, result, {"written": written, "records": records, "request": request})
