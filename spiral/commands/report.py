"""The verb ``report``, and saving the series that it needs beside each run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spiral.commands.study import Command, Tell
from spiral.io.request import OK, Outcome, Request
from spiral.types.errors import ConfigError, InputError, did_you_mean

if TYPE_CHECKING:
    from spiral.types.run import Comparison

PAGE = "report.html"
_KEYS = ("run", "out")


def run_and_save_curves(study: Command, step: Callable[[Command], Outcome]) -> Outcome:
    """Carry out a verb, then write the curves that a report needs beside its saved run.

    The result is saved first: where the curves cannot be computed, only they are missing. Jobs of
    a sweep write none.
    """
    from spiral.io.config import top_level_options

    outcome = step(study)
    compared = _comparisons_by_model(outcome.parts)
    sweeping = bool((study.config.get("sweep") or {}).get("id"))
    if "run_id" not in outcome.result or not compared or sweeping:
        return outcome
    if not top_level_options(study.config).curves:
        return outcome
    from spiral.io.compute_curves import gather_curves
    from spiral.io.curves import FINAL, write_curves

    if not isfinite(compared[FINAL].fit_error):
        study.tell("no curves for the report: the fit diverged")
        return outcome
    folder = Path(study.config["out"]).expanduser() / outcome.result["run_id"]
    try:
        write_curves(gather_curves(outcome.parts["problem"], compared, study.tell), folder)
    except (ArithmeticError, ValueError, OSError) as error:  # LinAlgError is a ValueError
        study.tell(f"no curves for the report: {error}")
    return outcome


def _comparisons_by_model(parts: Mapping[str, Any]) -> dict[str, Comparison]:
    """The comparisons of an outcome by model: seed and final, or the final one alone."""
    from spiral.io.curves import FINAL, SEED

    run = parts.get("run")
    if run is not None:
        done = [r.comparison for r in run.rounds]
        return {SEED: done[0], FINAL: done[-1]} if len(done) > 1 else {FINAL: done[-1]}
    diagnosis = parts.get("diagnosis")
    only = parts.get("comparison") if diagnosis is None else diagnosis.comparison
    return {} if only is None else {FINAL: only}


def report(request: Request, tell: Tell) -> Outcome:
    """One HTML file of a saved run, from its saved files alone.

    Raises
    ------
    ConfigError : an option it has not, or no such run. InputError : a file that cannot be written.
    """
    from spiral.io.curves import read_curves
    from spiral.io.overrides import parse_overrides
    from spiral.io.storage import load_run
    from spiral.io.writing import write_whole
    from spiral.view.report.html import report_page

    given = {".".join(i.path): i.value for i in parse_overrides(request.overrides)}
    for key in (*given, *request.names):
        if key not in _KEYS:
            raise ConfigError(
                f"report {key}", "spiral report run=ID [out=FOLDER] [--out FILE.html]",
                did_you_mean(key, _KEYS) or "spiral report run=latest",
            )  # fmt: skip
    saved = load_run(str(given.get("run") or "latest"), str(given.get("out") or "runs"))
    tell("drawing")
    html, names = report_page(saved.data, read_curves(saved.file.parent))
    target = Path(request.out).expanduser() if request.out else saved.file.with_name(PAGE)
    try:
        write_whole(target, html)
    except OSError as error:
        raise InputError(
            f"--out {target}: {error.strerror or error}", "a file that can be written"
        ) from error
    result = {"run": saved.run_id, "file": str(target), "bytes": len(html.encode()),
              "figures": names}  # fmt: skip
    return Outcome(OK, result, {"request": request})
