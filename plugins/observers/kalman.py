"""Kalman filters and the smoother, on any model, with its exact Jacobian."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, Literal

from spiral.engine.filter.observer import Observer, Reconstruction

if TYPE_CHECKING:
    from spiral.engine.filter.extended import FilterPass, FilterSettings
    from spiral.engine.filter.task import FilterInput
    from spiral.types.record import Array


class Tuned(Observer):
    """A filter whose covariances are shares of the model's own settled motion.

    Units and amplitude then do not matter.

    Fields
    ------
    process_noise : share of the rates that the model does not know, one number or by group
        (``observed``, ``hidden``); left out, by maximum likelihood of the innovations.
    track : parameters estimated as states; left out, the record's own (a rotor's phase origin).
    doubt : their first standard deviations by name.
    spread : initial standard deviation of the states as a share of the settled one.
    """

    doubts: ClassVar[bool] = True

    process_noise: Mapping[str, float] | float | None = None
    track: tuple[str, ...] | None = None
    doubt: Mapping[str, float] | None = None
    spread: float = 1.0

    def reconstruct(self, task: FilterInput) -> Reconstruction:
        """Choose the process noise, then run once; more often where parameters are uncertain."""
        from spiral.engine.filter.extended import as_reconstruction
        from spiral.engine.filter.rounding import refine_steps
        from spiral.engine.filter.setup import (
            choose_levels,
            prepare_filter,
            with_level,
            zero_unneeded_levels,
        )
        from spiral.engine.filter.tuning import LOWEST

        clock = time.perf_counter()
        task, settings = prepare_filter(task, self.track, self.doubt, self.spread)
        if task.prior is not None:
            return self._reconstruct_uncertain(task, settings, clock)
        levels = choose_levels(task, settings, self.process_noise)
        if min(levels.values()) < LOWEST:
            task = refine_steps(task)
            levels = (
                zero_unneeded_levels(task, settings, levels)
                if self.process_noise is None
                else levels
            )
        tuned = time.perf_counter()
        settings = with_level(task, settings, levels)
        filter_pass = self.run(task, settings)
        seconds = time.perf_counter() - tuned
        return as_reconstruction(task, settings, filter_pass, levels, seconds, tuned - clock)

    def _reconstruct_uncertain(
        self, task: FilterInput, settings: FilterSettings, clock: float
    ) -> Reconstruction:
        """Reconstruct with uncertain parameters: bands hold the spread of their posterior."""
        from spiral.engine.filter.extended import as_reconstruction
        from spiral.engine.filter.marginal import add_parameter_doubt
        from spiral.engine.filter.posterior import posterior
        from spiral.engine.filter.setup import with_level

        known = posterior(task, settings, self.process_noise)
        tuned = time.perf_counter()
        task, settings = known.task, with_level(task, settings, known.levels)
        prior = task.prior
        assert prior is not None

        def run_at_values(values: Array) -> FilterPass:
            return self.run(task.with_parameters(prior.keys, values), settings)

        top = self.run(task, settings)
        whole = top.done == task.series.samples
        averaged = add_parameter_doubt(run_at_values, known, top) if whole else None
        seconds = time.perf_counter() - tuned
        made = as_reconstruction(
            task,
            settings,
            averaged.filter_pass if averaged else top,
            known.levels,
            seconds,
            tuned - clock,
        )
        return replace(made, values=averaged.values(prior.keys)) if averaged else made

    @abstractmethod
    def run(self, task: FilterInput, settings: FilterSettings) -> FilterPass:
        """One run over the record with these numbers."""


class Ekf(Tuned):
    """Extended Kalman filter: mean by RK4, covariance by the Jacobian of that very step.

    x <- x + K (y - h(x)), K = P C^T S^-1, S = C P C^T + R; P in Joseph form; process noise by exact
    discretisation.

    Fields
    ------
    transition : ``exact``, or the paper's ``second_order`` (eq. ekf_Phi).
    """

    transition: Literal["exact", "second_order"] = "exact"

    def run(self, task: FilterInput, settings: FilterSettings) -> FilterPass:
        """Filter the record."""
        from spiral.engine.filter.extended import filter_record

        settings = replace(settings, second_order=self.transition == "second_order")
        return filter_record(task, settings, keep=bool(task.series.record.truth))


class Rts(Tuned):
    """Rauch-Tung-Striebel smoother over the extended filter: each sample judged by all.

    x_s = x - P l, P_s = P - P L P, in the Bryson-Frazier form (``spiral.engine.filter.smoother``).
    """

    def run(self, task: FilterInput, settings: FilterSettings) -> FilterPass:
        """Filter, then go back from the record's end; innovations stay those of the filter."""
        from spiral.engine.filter.extended import filter_record, smooth_run

        filter_pass = filter_record(task, settings, keep=True)
        return filter_pass if filter_pass.done < task.series.samples else smooth_run(filter_pass)


class Ukf(Tuned):
    """Unscented Kalman filter: 2 N + 1 points in place of Jacobians.

    x = sum_i w_i x_i, P = sum_i w_i (x_i - x)(x_i - x)^T over points x +- sqrt(N + lambda) L_i.
    Its process noise is tuned with the extended filter's likelihood, which costs less.

    Fields
    ------
    alpha, beta, kappa : of the points (van der Merwe 2004); as given, the cubature filter.
    """

    alpha: float = 1.0
    beta: float = 0.0
    kappa: float = 0.0

    def run(self, task: FilterInput, settings: FilterSettings) -> FilterPass:
        """Filter the record."""
        from spiral.engine.filter.sigma_points import filter_sigma_points

        shape = (self.alpha, self.beta, self.kappa)
        return filter_sigma_points(task, settings, shape, keep=bool(task.series.record.truth))
