"""Fit a model to whole records before its states are reconstructed.

The shooting fit of ``compare`` on growing windows, hidden states free in every window, up to the
whole record with one initial state; parameters of the machine are shared by all records, each
record keeps its own phase origin.
"""

from __future__ import annotations

from dataclasses import dataclass

from spiral.assembly import to_model
from spiral.compare import last_stage, prepared, standard_errors
from spiral.evidence import all_samples
from spiral.model import Model
from spiral.problem import Problem, Progress, silent
from spiral.record import Array
from spiral.threads import one_blas_thread


@dataclass(frozen=True)
class Calibration:
    """A fitted model, for each record with its own values; ``horizon`` the longest window reached.

    ``grids`` are inputs on the half-step grid with their substeps, where the fit corrected a phase.
    """

    models: tuple[Model, ...]
    grids: tuple[tuple[Array, int], ...]
    converged: bool
    horizon: int
    chi2_per_dof: float

    @property
    def model(self) -> Model:
        """The model with the first record's values."""
        return self.models[0]


@one_blas_thread
def calibrate(problem: Problem, progress: Progress = silent) -> Calibration:
    """Fit every parameter that the problem's model lets move, on all samples of its records."""
    assembly, standing = prepared(problem, ())
    progress("calibrating on growing windows, hidden states free")
    stage = last_stage(assembly, standing, all_samples(assembly))
    values, study = stage.fitted.point.values, assembly.study
    errors = standard_errors(assembly, standing, stage)
    return Calibration(
        models=tuple(
            to_model(assembly, standing.labels, values[r : r + 1], errors)
            for r in range(len(study.series))
        ),
        grids=tuple((study.inputs(r, values[r]), s.substeps) for r, s in enumerate(study.series)),
        converged=stage.fitted.converged,
        horizon=int(stage.length),
        chi2_per_dof=stage.fitted.chi2_per_dof,
    )
