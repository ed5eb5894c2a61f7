"""The verbs ``discover``, ``compare``, ``diagnose``, ``add`` and ``simulate``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import isfinite
from typing import TYPE_CHECKING, Any

from spiral.io.request import OK, REFUSED, Outcome, Request
from spiral.types.errors import ConfigError
from spiral.types.formatting import capitalised

if TYPE_CHECKING:
    from spiral.inference.problem import Problem
    from spiral.inference.rounds import Checkpoint
    from spiral.io.config import Config
    from spiral.io.registry import Registry
    from spiral.types.model import Model
    from spiral.types.record import Record
    from spiral.types.run import Comparison, Round, Run

    Records = tuple[Record, ...]


OnRound = Callable[["Round"], None]
"""Told of a round once its candidates are ranked."""
SoFar = Callable[[dict[str, Any]], None]
"""Given what a study knows, as plain data, whenever it knows more."""
Tell = Callable[[str], None]


def _records_of(problem: Problem) -> dict[str, Records]:
    return {"records": problem.records, "test": problem.test}


@dataclass(frozen=True)
class Command:
    """A request with its composed configuration; the problem is built when a verb asks."""

    request: Request
    config: Config
    registry: Registry
    tell: Tell
    on_round: OnRound | None
    so_far: SoFar | None = None

    def problem(self) -> Problem:
        """Records loaded, test kept apart."""
        from spiral.io.config import build_problem

        return build_problem(self.config, self.registry)

    def save_with_id(self, run: Run, problem: Problem) -> Run:
        """Write the run to the folder of runs; returns it with its id."""
        return replace(run, run_id=self.save(run.as_dict(), run.model, problem))

    def save(self, result: Mapping[str, Any], model: Model, of: Problem | Records) -> str:
        """Write a result with its model to the folder of runs; returns the run's id."""
        from spiral.io.storage import save_result

        data = {"records": of} if isinstance(of, tuple) else _records_of(of)
        verb, out, given = self.request.verb, self.config["out"], self.request.overrides
        return save_result(verb, result, model, self.config, data, self.registry, out, given)

    def parts(self, problem: Problem, **more: Any) -> dict[str, Any]:
        """What the terminal and MLflow need besides the result."""
        return {"problem": problem, "request": self.request, "config": self.config,
                "registry": self.registry, **more}  # fmt: skip


def discover(study: Command) -> Outcome:
    """The whole discovery loop; exit 3 where the record cannot tell or a fit diverged."""
    problem = study.problem()
    run = study.save_with_id(_run_discovery_loop(study, problem), problem)
    result = run.as_dict()
    refused = run.stopped in ("not_identifiable", "diverged")
    if refused:
        result["error"] = _refusal_error(run.stopped, run.advice)
    return Outcome(REFUSED if refused else OK, result, study.parts(problem, run=run))


def _run_discovery_loop(study: Command, problem: Problem) -> Run:
    """Run the discovery loop from where an unfinished study stopped; rounds are saved on disk."""
    from spiral.inference.discover import discover
    from spiral.io.checkpoint import checkpoint_keeper

    with checkpoint_keeper(study.config, problem, study.registry, study.config["out"]) as kept:
        last = kept.read_last()
        if last is not None:
            study.tell(f"taking up this study, left unfinished in round {len(last.rounds)}")

        def keep(at: Checkpoint) -> None:
            kept.write(at)
            _write_what_is_known(study, at, problem)

        try:
            run = discover(problem, study.tell, study.on_round, keep, last)
        except (KeyboardInterrupt, SystemExit):  # Ctrl-C, SIGTERM
            if (known := kept.read_last()) is not None:  # perhaps kept, and not written yet
                _write_what_is_known(study, known, problem)
                _tell_what_is_known(known, problem)
            raise
        kept.remove()
    return run


def _write_what_is_known(study: Command, at: Checkpoint, problem: Problem) -> None:
    if study.so_far is not None:
        study.so_far(_unfinished_result(at, problem))


def _unfinished_result(at: Checkpoint, problem: Problem) -> dict[str, Any]:
    """What a study knows that has not ended, as plain data; its error says so."""
    from spiral.inference.verdict import interrupted_summary
    from spiral.types.model import estimates_dict

    return {
        "error": {
            "given": f"a study that was stopped after round {len(at.rounds) - 1}",
            "expected": "time for it to end",
            "try": "the same command, which goes on from there",
        },
        "summary": interrupted_summary(at.rounds, problem.settings),
        "rounds": [r.as_dict() for r in at.rounds],
        "model": estimates_dict(at.rounds[-1].comparison.model),
    }


def _tell_what_is_known(last: Checkpoint, problem: Problem) -> None:
    """Say what a study has found that is stopped, and that the same command goes on from there."""
    from spiral.inference.verdict import interrupted_summary

    done, known = len(last.rounds) - 1, interrupted_summary(last.rounds, problem.settings)
    print(f"After round {done}: {known}", file=sys.stderr)
    print("The same command goes on from there.", file=sys.stderr)


def compare(study: Command) -> Outcome:
    """The model as configured against the test record; exit 3 where the fit did not converge."""
    from spiral.inference.compare import compare
    from spiral.view.terminal.preview import describe_records

    problem = study.problem()
    comparison = compare(problem, study.tell)
    result = {**comparison.as_dict(), "records": describe_records(problem)}
    result["run_id"] = study.save(result, comparison.model, problem)
    if error := _fit_failure(comparison):
        result["error"] = error
    code = REFUSED if error else OK
    return Outcome(code, result, study.parts(problem, comparison=comparison))


def diagnose(study: Command) -> Outcome:
    """The verdict on the model as it is; exit 3 where the record cannot tell or a fit diverged."""
    from spiral.inference.diagnose import diagnose

    problem = study.problem()
    diagnosis = diagnose(problem, study.tell)
    result = diagnosis.as_dict()
    result["run_id"] = study.save(result, diagnosis.comparison.model, problem)
    refused = diagnosis.verdict == "not_identifiable" or diagnosis.diverged
    if refused:
        reason = "diverged" if diagnosis.diverged else diagnosis.verdict
        result["error"] = _refusal_error(reason, diagnosis.advice)
    return Outcome(REFUSED if refused else OK, result, study.parts(problem, diagnosis=diagnosis))


def add(study: Command) -> Outcome:
    """The model before and after the named effects; exit 3 where the fit did not converge."""
    from spiral.inference.discover import add
    from spiral.types.model import estimates_dict

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
    run = study.save_with_id(run, problem)
    result = {
        "before": before.as_dict(),
        "after": after.as_dict(),
        "model": estimates_dict(run.model),
        "run_id": run.run_id,
    }
    if error := _fit_failure(after):
        result["error"] = error
    parts = study.parts(problem, before=before, after=after, run=run)
    return Outcome(REFUSED if error else OK, result, parts)


def _refusal_error(verdict: str, advice: str) -> dict[str, str]:
    given = {
        "not_identifiable": "a record in which the model's effects look alike",
        "diverged": "a model whose motion runs away from the record",
    }[verdict]
    expected = {
        "not_identifiable": "excitation that tells them apart",
        "diverged": "a model near enough to follow the record",
    }[verdict]
    return {"given": given, "expected": expected, "try": advice}


def _fit_failure(comparison: Comparison) -> dict[str, str]:
    """The error for a fit that did not converge, or whose free run diverges; else empty.

    A machine that only its controller holds has no free run: it is told one sample ahead.
    """
    from spiral.inference.nearness import is_free_run_carried_away, next_sample_error

    ahead = next_sample_error(comparison) if is_free_run_carried_away(comparison) else None
    if comparison.converged and (
        isfinite(comparison.fit_error) or (ahead is not None and ahead < 1)
    ):
        return {}
    where = "" if comparison.random is not None else f" on windows of {comparison.horizon} samples"
    given = "a model whose free run leaves all bounds"
    asked = [capitalised(s) for s in comparison.contradictions if s.endswith("?")]
    first = "spiral diagnose with the same overrides, or first values: values='{NAME: VALUE}'"
    return {
        "given": given if comparison.converged else f"a fit that does not converge{where}",
        "expected": "a model near enough to follow the record",
        "try": " ".join((*asked, first)),
    }


def simulate(request: Request, config: Config, registry: Registry) -> Outcome:
    """A record from a model, written as a table."""
    from spiral.io.config import build_sources, build_system
    from spiral.io.tables import write_record

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
