"""Innovations as a regression: whitened, with their slopes by parameters.

With S = L L^T and v the innovation of a sample, e = L^-1 v has the covariance I where the model is
right, and with d = C dx/dp + h_p (``slopes_kernel``)

    e(p + step) = e(p) - L^-1 d step

to first order: least squares of e on the columns L^-1 d is one scoring step of the likelihood of
the innovations, and the fall of |e|^2 is twice the gain in its logarithm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spiral.engine.filter.extended import FilterPass, FilterSettings, filter_record, tracked_indices
from spiral.engine.filter.task import FilterInput
from spiral.physics.flow import compile_flow
from spiral.types.record import Array


@dataclass(frozen=True)
class WhitenedRecord:
    """One record: e (samples, channels) and columns (samples, channels, parameters).

    Rows of a sample that was not measured are zero. ``found`` is the filter's run.
    """

    innovations: Array
    columns: Array
    filter_pass: FilterPass


def whiten_innovations(
    task: FilterInput, settings: FilterSettings, keys: tuple[str, ...]
) -> WhitenedRecord | None:
    """The record filtered and its innovations whitened; nothing where the filter runs away.

    Parameters
    ----------
    keys : parameters differentiated, none of them tracked.
    """
    from spiral.engine.filter.slopes_kernel import prediction_slopes

    run = filter_record(task, settings, keep=True)
    if run.done < task.series.samples:
        return None
    tracked = tracked_indices(task, settings.tracked)
    both = np.concatenate([tracked, tracked_indices(task, keys)])
    slopes = np.zeros((*run.innovations.shape, len(keys)))
    if keys:
        flow = compile_flow(task.compiled.traced, (*settings.tracked, *keys))
        prediction_slopes(
            flow.advance, flow.output,
            np.concatenate([settings.start, task.values[tracked]]), task.values.copy(), both,
            len(tracked), task.inputs, task.series.substeps, task.series.dt, run.means,
            run.gains, slopes,
        )  # fmt: skip
    if not np.all(np.isfinite(slopes)):
        return None
    seen = run.spreads[:, 0, 0] > 0
    root = np.linalg.cholesky(run.spreads[seen])
    whole = np.concatenate([run.innovations[seen][..., None], slopes[seen]], axis=2)
    rows = np.zeros((len(seen), *whole.shape[1:]))
    rows[seen] = np.linalg.solve(root, whole)
    return WhitenedRecord(rows[..., 0], rows[..., 1:], run)
