"""The verb ``estimate``: reconstruct all states of records, from a request to an outcome."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_args

from spiral.io.request import OK, REFUSED, Outcome
from spiral.types.errors import ConfigError
from spiral.types.parameter import Interpolation

if TYPE_CHECKING:
    from spiral.commands.study import Command
    from spiral.inference.reconstruction.calibrate import Calibration
    from spiral.inference.reconstruction.estimate import Estimation
    from spiral.io.tables import WrittenTable
    from spiral.types.model import Model
    from spiral.types.record import Record


def reconstruct_states(study: Command) -> Outcome:
    """Reconstruct all states of the configured records; exit 3 where the observer diverged."""
    from spiral.inference.reconstruction.estimate import estimate
    from spiral.inference.reconstruction.uncertain import fitted_prior
    from spiral.io.config import build_model, build_observer, build_sources, top_level_options

    config, registry = study.config, study.registry
    observer = build_observer(config, registry)
    model = build_model(config, registry)
    source, _ = build_sources({**config, "test": {"name": None}}, registry)
    records = source.load(model.system)
    fitted = _calibrate_if_needed(study, model, records)
    models = fitted.models if fitted else (model,) * len(records)
    uncertain = top_level_options(study.config).uncertain
    if fitted and uncertain:
        raise ConfigError(
            "uncertain= of a model that is fitted first", "one of them",
            "calibrate=false keeps the values that are given",
        )  # fmt: skip
    known = tuple(fitted_prior(fitted, i) for i in range(len(records))) if fitted else ()
    grids = fitted.grids if fitted else ()
    between = _inputs_as_found(config)
    estimation = estimate(models, records, observer, study.tell, grids, uncertain, known, between)
    written = _write_state_tables(study.request.out, estimation)
    result: dict[str, Any] = estimation.as_dict()
    result["calibration"] = _calibration_dict(fitted) if fitted else None
    result["files"] = [w.as_dict() for w in written]
    result["run_id"] = study.save(result, fitted.model if fitted else model, records)
    if estimation.diverged:
        result["error"] = _divergence_error(estimation)
    parts = {
        "estimation": estimation,
        "calibration": fitted,
        "written": written,
        "records": records,
        "request": study.request,
        "config": config,
        "registry": registry,
    }
    return Outcome(REFUSED if estimation.diverged else OK, result, parts)


def _inputs_as_found(config: dict[str, Any]) -> dict[str, Interpolation]:
    """How inputs run between their samples, as the study of the run that is taken up found it."""
    from spiral.io.storage import load_run

    if not config.get("run"):
        return {}
    found = load_run(config["run"], config["out"]).result.get("between")
    known = found.items() if isinstance(found, dict) else ()
    return {str(name): way for name, way in known if way in get_args(Interpolation)}


def _calibrate_if_needed(
    study: Command, model: Model, records: tuple[Record, ...]
) -> Calibration | None:
    """Fit the model first where asked for, or where a parameter has no value; else ``None``."""
    from spiral.inference.problem import Problem
    from spiral.inference.reconstruction.calibrate import calibrate
    from spiral.io.config import statistics_settings, top_level_options

    wanted = top_level_options(study.config).calibrate
    unknown = any(p.start is None and k not in model.values for k, p in model.pairs)
    if not (unknown if wanted is None else wanted):
        return None
    problem = Problem(model, records, (), settings=statistics_settings(study.config))
    return calibrate(problem, study.tell)


def _calibration_dict(fitted: Calibration) -> dict[str, Any]:
    from spiral.types.model import estimates_dict

    return {
        "converged": fitted.converged,
        "horizon": fitted.horizon,
        "chi2_per_dof": fitted.chi2_per_dof,
        "model": estimates_dict(fitted.model),
        "not_identifiable": list(fitted.untold),
    }


def _write_state_tables(out: str | None, estimation: Estimation) -> tuple[WrittenTable, ...]:
    from spiral.io.tables import write_states

    if out is None:
        return ()
    several = len(estimation.parts) > 1
    return tuple(
        written
        for i, part in enumerate(estimation.parts)
        for written in write_states(part, out, i if several else None)
    )


def _divergence_error(estimation: Estimation) -> dict[str, str]:
    part = next(p for p in estimation.parts if p.diverged)
    stop = part.stable * part.record.dt
    return {
        "given": f"{estimation.observer} loses {part.record.name} after {stop:.3g} s",
        "expected": "a filter that predicts each sample better than no motion at all",
        "try": f"use the states up to {stop:.3g} s; calibrate=true fits the model first, and "
        "observer=ekf tunes its process noise",
    }
