"""Reconstruct all states of a model with an observer, and say how far to trust the result.

Scored after the first second; errors only where the truth is known (simulated records). Relative
errors are over the standard deviation of the true state. Every result stands beside that of the
static map, which needs no filter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from spiral.engine.filter.observer import Observer, Reconstruction
from spiral.engine.filter.prior import Prior
from spiral.engine.filter.task import FilterInput, prepare_task
from spiral.engine.threads import one_blas_thread
from spiral.inference.problem import Progress, silent
from spiral.inference.reconstruction.consistency import (
    BoundedMean,
    Consistency,
    consistency,
    mean_with_bounds,
    normalised_squares,
)
from spiral.inference.reconstruction.consistency import stable_samples as stable
from spiral.inference.reconstruction.inputs import widen_by_undecided_inputs
from spiral.inference.reconstruction.observability import Observability, observability
from spiral.inference.reconstruction.uncertain import declared_prior, model_prior
from spiral.physics.effect_states import own_states
from spiral.types.display import Readable, Summary
from spiral.types.errors import ConfigError
from spiral.types.formatting import number, percent
from spiral.types.model import Model, pretty_unit
from spiral.types.parameter import Ways
from spiral.types.record import Array, Record, check_fits

if TYPE_CHECKING:
    import pandas as pd

SKIPPED = 1.0  # s at the start that are not scored
BAND = 1.959964  # half a 95 % band, in standard deviations
_REACHED = 0.02  # relative error whose first time is reported
_WINDOW = 0.1  # s over which that error is taken


@dataclass(frozen=True)
class StateScore:
    """One state: its mean band, and its errors where the truth is known.

    ``deviation`` is the mean standard deviation that the observer gives; ``rmse`` in the state's
    unit; ``relative`` over the true standard deviation; ``coverage_95`` the share of samples whose
    95 % band holds the truth; ``reached`` the s after which the error first falls under 2 %.
    """

    unit: str
    deviation: float
    rmse: float | None = None
    relative: float | None = None
    correlation: float | None = None
    coverage_95: float | None = None
    reached: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """As plain data, as ``--json`` writes it; error keys only where the truth is known."""
        entries: dict[str, Any] = {"unit": self.unit, "deviation": self.deviation}
        if self.rmse is not None:
            entries |= {
                "rmse": self.rmse,
                "relative": self.relative,
                "correlation": self.correlation,
                "coverage_95": self.coverage_95,
                "reached_2_percent_s": self.reached,
            }
        return entries


@dataclass(frozen=True)
class RecordReconstruction:
    """One record with what the observer made of it.

    ``undecided`` are inputs of which the record does not tell how they run between their samples,
    and nobody said it: the bands hold each way that may be.
    """

    record: Record
    task: FilterInput
    reconstruction: Reconstruction
    consistency: Consistency | None
    nees: BoundedMean | None
    stable: int
    undecided: tuple[str, ...] = ()

    @property
    def diverged(self) -> bool:
        """Whether the observer lost the record before its end."""
        return self.stable < self.record.samples

    @property
    def doubts(self) -> dict[str, dict[str, Any]]:
        """Uncertain parameters: standard deviation before the record, estimate and that after."""
        prior = self.task.prior
        if prior is None:
            return {}
        before = dict(zip(prior.keys, np.sqrt(np.diag(prior.covariance)), strict=True))
        return {
            k: {"before": float(before[k]), "estimate": v, "se": s, "unit": self.unit(k)}
            for k, (v, s) in self.reconstruction.values.items()
        }

    def series(self) -> pd.DataFrame:
        """Time, and of every state the estimate with its 95 % band: NAME, NAME_low, NAME_high.

        Samples after a divergence are left out; a state that the observer does not give has no
        columns.
        """
        import pandas as pd

        columns = {"time": self.record.time[: self.stable]}
        for name in self.reconstruction.names:
            mean, deviation = (v[: self.stable] for v in self.reconstruction.state(name))
            if not np.isnan(mean).all():
                columns[name] = mean
                columns[f"{name}_low"] = mean - BAND * deviation
                columns[f"{name}_high"] = mean + BAND * deviation
        return pd.DataFrame(columns)

    def unit(self, name: str) -> str:
        """Unit of a state or of a tracked parameter."""
        model = self.task.model
        known = {s.name: s.unit for s in model.system.states}
        own = own_states(model.system, model.effects)
        known |= {name: pretty_unit(unit) for name, unit in own.items()}
        return self.task.model.unit(name) if name in self.task.keys else known.get(name, "")


@dataclass(frozen=True, repr=False)
class Estimation(Readable):
    """States of one or several records of one machine, scored together."""

    observer: str
    model: Model
    parts: tuple[RecordReconstruction, ...]
    states: Mapping[str, StateScore]
    baseline: Mapping[str, float | None]
    observability: Observability

    def _shown(self) -> Summary:
        rows = tuple(
            (name, number(s.deviation, 3), percent(s.relative), percent(s.coverage_95), s.unit)
            for name, s in self.states.items()
        )
        said = "diverged" if self.diverged else f"mean NIS {number(self.nis_mean, 3)}"
        known = any(s.relative is not None for s in self.states.values())
        head = ("state", "standard deviation", "error", "truth in 95 % band", "unit")
        return Summary(
            f"States of {self.model.name} by {self.observer}: {said}",
            head,
            rows if known else tuple((*row[:2], "", "", row[4]) for row in rows),
            f"{self.band_sentence} series() gives them sample by sample.",
        )

    @property
    def band_sentence(self) -> str:
        """What beside the noise is uncertain in the bands: parameters, inputs between samples."""
        prior = self.parts[0].task.prior
        undecided = dict.fromkeys(n for p in self.parts for n in p.undecided)
        if prior is None:
            said = (
                "The bands hold for a model whose parameters are exact (uncertain= with ekf, "
                "ukf or rts widens them)."
            )
        else:
            count = len(prior.keys)
            noun = "parameter" if count == 1 else "parameters"
            said = f"The bands hold the uncertainty of {count} {noun} as well."
        if not undecided:
            return said
        words = " and ".join(undecided)
        return (
            f"{said} They hold every way in which {words} may run between samples, which the "
            f"record does not tell; record.hold declares it."
        )

    def series(self, record: int = 0) -> pd.DataFrame:
        """Every state of a record over time with its band (``RecordReconstruction.series``)."""
        return self.parts[record].series()

    @property
    def diverged(self) -> bool:
        """Whether any record was lost."""
        return any(p.diverged for p in self.parts)

    @property
    def nis_mean(self) -> float:
        """Mean NIS over all records; not a number for an observer without innovations."""
        known = [p.consistency.nis.mean for p in self.parts if p.consistency]
        return float(np.mean(known)) if known else np.nan

    def as_dict(self) -> dict[str, Any]:
        """As plain data, as ``--json`` writes it."""
        first = self.parts[0]
        names = [n for n in first.reconstruction.names if n not in first.task.states]
        return {
            "observer": self.observer,
            "states": {k: v.as_dict() for k, v in self.states.items()},
            "nis_mean": self.nis_mean,
            "static_baseline": {k: {"relative": v} for k, v in self.baseline.items()},
            "seconds": sum(p.reconstruction.seconds for p in self.parts),
            "tuning_seconds": sum(p.reconstruction.tuning_seconds for p in self.parts),
            "observability": self.observability.as_dict(),
            "records": [_record_as_dict(p) for p in self.parts],
            "process_noise": dict(first.reconstruction.levels),
            "tracked": {n: _last_estimate(first, n) for n in names},
        }


def _record_as_dict(part: RecordReconstruction) -> dict[str, Any]:
    statistics = part.consistency.as_dict() if part.consistency else {}
    return {
        "name": part.record.name,
        **statistics,
        "nees": part.nees.as_dict() if part.nees else None,
        "diverged": part.diverged,
        "stable_s": [0.0, part.stable * part.record.dt],
        "log_likelihood": part.reconstruction.log_likelihood,
        "uncertain": part.doubts,
    }


def _last_estimate(part: RecordReconstruction, name: str) -> dict[str, float]:
    means, deviations = part.reconstruction.state(name)
    at = max(part.reconstruction.done - 1, 0)
    return {"estimate": float(means[at]), "se": float(deviations[at])}


@one_blas_thread
def estimate(
    models: Sequence[Model],
    records: Sequence[Record],
    observer: Observer,
    progress: Progress = silent,
    grids: Sequence[tuple[Array, int] | None] = (),
    uncertain: Mapping[str, Any] | None = None,
    known: Sequence[Prior | None] = (),
    between: Ways | None = None,
) -> Estimation:
    """Run an observer over records.

    Parameters
    ----------
    models : one for each record (they differ in the values that belong to a record).
    grids : for each record, inputs as of ``stage_inputs`` and their substeps, where a fit has
        corrected them.
    uncertain : what is declared of parameters (``spiral.inference.reconstruction.uncertain``);
        none, the standard errors that a model has of a fit; empty, nothing: values are exact.
    known : for each record, what a fit knows of them.
    between : how a study found inputs to run between their samples, where no record declares it.

    Raises
    ------
    ConfigError : doubt that was declared, and an observer whose bands cannot hold it.
    """
    if uncertain and not observer.doubts:
        raise ConfigError(
            f"uncertain= with observer={observer.plugin_name()}",
            "an observer whose bands take it in", "observer=rts, ekf or ukf",
        )  # fmt: skip
    parts = []
    for index, (model, record) in enumerate(zip(models, records, strict=True)):
        check_fits(model.system, record)
        inputs, substeps = (grids[index] if grids else None) or (None, None)
        running = record.running(between or {})
        task = prepare_task(model, running, inputs=inputs, substeps=substeps)
        if observer.doubts:
            fitted = known[index] if known else None
            task = replace(task, prior=_prior_of(model, task, uncertain, fitted))
        progress(f"{observer.plugin_name()} over {record.name}: {record.samples} samples")
        part = reconstruct_record(task, observer)
        if observer.doubts and inputs is None and not part.diverged:
            progress(f"inputs of {record.name} between their samples")
            wider = widen_by_undecided_inputs(
                task, observer, part.reconstruction, record, between or {}
            )
            nees = _nees(task, wider.reconstruction, skipped_samples(record))
            part = replace(
                part, reconstruction=wider.reconstruction, nees=nees, undecided=wider.names
            )
        parts.append(part)
    return combine_reconstructions(observer.plugin_name(), parts)


def _prior_of(
    model: Model, task: FilterInput, uncertain: Mapping[str, Any] | None, fitted: Prior | None
) -> Prior | None:
    """What is declared, else what a fit of the records knows, else what the model's own does."""
    if uncertain is not None:
        return declared_prior(model, task, uncertain)
    return model_prior(model, task) if fitted is None else fitted


def reconstruct_record(task: FilterInput, observer: Observer) -> RecordReconstruction:
    """One record through an observer, with its statistics."""
    record = task.series.record
    reconstruction = observer.reconstruct(task)
    first = skipped_samples(record)
    return RecordReconstruction(
        record,
        task,
        reconstruction,
        consistency(reconstruction, record, first),
        _nees(task, reconstruction, first),
        stable(reconstruction, record),
    )


def skipped_samples(record: Record) -> int:
    """Samples of the first second, at most half the record."""
    return min(round(SKIPPED / record.dt), record.samples // 2)


def combine_reconstructions(observer: str, parts: Sequence[RecordReconstruction]) -> Estimation:
    """All records of a machine scored together, with the static map on the same samples."""
    first = parts[0]
    names = first.task.states
    mapping = first.task.static
    hidden = mapping.hidden if mapping else ()
    return Estimation(
        observer=observer,
        model=first.task.model,
        parts=tuple(parts),
        states={n: _score_state(parts, n) for n in names},
        baseline={n: _static_baseline(parts, n) for n in hidden},
        observability=observability(first.task),
    )


def _score_state(parts: Sequence[RecordReconstruction], name: str) -> StateScore:
    means, deviations, truth = [], [], []
    for part in parts:
        cut = slice(skipped_samples(part.record), part.stable)
        mean, deviation = part.reconstruction.state(name)
        means.append(mean[cut])
        deviations.append(deviation[cut])
        truth.append(part.record.truth[name][cut] if name in part.record.truth else None)
    unit = parts[0].unit(name)
    mean, deviation = np.concatenate(means), np.concatenate(deviations)
    size = float(np.mean(deviation)) if len(deviation) else np.nan
    true = [t for t in truth if t is not None]
    if len(true) < len(parts) or not len(mean) or np.isnan(mean).all():
        return StateScore(unit, size)
    reference = np.concatenate(true)
    error = mean - reference
    rmse = float(np.sqrt(np.mean(error**2)))
    return StateScore(
        unit, size, rmse,
        relative=rmse / float(np.std(reference)),
        correlation=float(np.corrcoef(mean, reference)[0, 1]),
        coverage_95=float(np.mean(np.abs(error) <= BAND * deviation)),
        reached=_time_to_two_percent(parts[0], name),
    )  # fmt: skip


def _static_baseline(parts: Sequence[RecordReconstruction], name: str) -> float | None:
    """Relative error of the static map for one hidden state, where the truth is known."""
    errors, reference = [], []
    for part in parts:
        mapping = part.task.static
        if mapping is None or name not in part.record.truth:
            return None
        cut = slice(skipped_samples(part.record), part.stable)
        seen = np.column_stack([part.record.channels[n][cut] for n in mapping.observed])
        true = part.record.truth[name][cut]
        errors.append(seen @ mapping.matrix[mapping.hidden.index(name)] - true)
        reference.append(true)
    spread = float(np.std(np.concatenate(reference)))
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) / spread if spread else None


def _time_to_two_percent(part: RecordReconstruction, name: str) -> float | None:
    """Seconds until the rms error over the last tenth of a second first falls under 2 %."""
    truth, dt = part.record.truth[name], part.record.dt
    width = max(1, round(_WINDOW / dt))
    error = (part.reconstruction.state(name)[0] - truth) ** 2
    if len(error) <= width or not np.isfinite(error).any():
        return None
    sums = np.cumsum(np.concatenate([[0.0], np.nan_to_num(error, nan=np.inf)]))
    with np.errstate(invalid="ignore"):
        rms = np.sqrt((sums[width:] - sums[:-width]) / width) / np.std(truth)
    below = np.flatnonzero(rms < _REACHED)
    return float((below[0] + width) * dt) if len(below) else None


def _nees(task: FilterInput, reconstruction: Reconstruction, first: int) -> BoundedMean | None:
    truth = task.series.record.truth
    if not len(reconstruction.covariances) or any(n not in truth for n in task.states):
        return None
    n, cut = len(task.states), slice(first, reconstruction.done)
    error = reconstruction.means[cut, :n] - np.column_stack([truth[s][cut] for s in task.states])
    return mean_with_bounds(normalised_squares(error, reconstruction.covariances[cut, :n, :n]), n)
