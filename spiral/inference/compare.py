"""Compare a model with measurements: fit, free run, and the statistics of what is left."""

from __future__ import annotations

from spiral.engine.threads import one_blas_thread
from spiral.inference.evidence.assembly import assemble, initial_values
from spiral.inference.evidence.comparison import (
    compare_fit,
    free_run_on_test,
    last_stage,
    prepare_study,
)
from spiral.inference.evidence.fit_state import FitState, all_samples
from spiral.inference.evidence.free_run import FreeRun
from spiral.inference.problem import Problem, Progress, silent
from spiral.inference.rounds import strategy_for
from spiral.types.model import Model
from spiral.types.record import Record
from spiral.types.run import Comparison


@one_blas_thread
def compare(problem: Problem, progress: Progress = silent) -> Comparison:
    """Fit the model as it is, as the problem's strategy does; compare it with the test record."""
    return strategy_for(problem).compare(problem, progress)


def compare_on_windows(problem: Problem, progress: Progress) -> Comparison:
    """The model fitted to all samples on growing windows, compared with the test record."""
    assembly, fit_state = prepare_study(problem, ())
    progress("fitting on growing windows")
    stage = last_stage(assembly, fit_state, all_samples(assembly))
    return compare_fit(
        assembly, FitState(fit_state.labels, stage.fitted.point.values), stage, progress
    )


@one_blas_thread
def predict(model: Model, records: tuple[Record, ...], settle: float | None = None) -> FreeRun:
    """Free run of a fitted model on records it has not seen.

    The first ``settle`` seconds (left out: a tenth of the shortest record) give each record's own
    nuisances, its initial state among them; the parameters stay as they are.
    """
    assembly = assemble(Problem(model, records, records, settle))
    run = free_run_on_test(assembly, model.labels, initial_values(assembly))
    assert run is not None
    return run
