"""A search for noise that leads a candidate's values astray is not followed."""

from dataclasses import replace

import numpy as np
import pytest

import spiral
from spiral.inference.evidence.enlarge import enlarge
from spiral.inference.likelihood.fitting import fit_by_likelihood
from spiral.inference.problem import silent
from spiral.inference.rounds import rank_last_round, start_study, strategy_for
from spiral.inference.strategies.likelihood import whole_fit

VALUES = {
    "system.mass": 1.2, "linear_stiffness.stiffness": 4e3, "linear_damping.damping": 6.0,
    "cubic_stiffness.stiffness": 2e9,
}  # fmt: skip
STIFFNESS = "linear_stiffness.stiffness"


@pytest.fixture(scope="module")
def begun():
    """A study of a spring that stiffens, its candidate, and the records."""
    record, test = (
        spiral.simulate(
            "oscillator", duration=2.0, rate=500.0, effects=["cubic_stiffness"],
            inputs={"force": {"noise": 1.0, "band": [2, 40]}}, values=VALUES, noise_level=0.01,
            seed=seed,
        )
        for seed in (1, 2)
    )  # fmt: skip
    question = spiral.discover(
        record, "oscillator", test=test, candidates=["cubic_stiffness"],
        settings={"max_rounds": 1},
    ).question  # fmt: skip
    strategy = strategy_for(question)
    started = strategy.begin(question, silent)
    _, step = rank_last_round(strategy, started.assembly, start_study(started, 0.0), silent)
    return started, step


@pytest.mark.parametrize("astray", [False, True])
def test_the_noise_of_before_stays_where_unseen_data_are_predicted_worse(
    begun, astray, monkeypatch
):
    started, step = begun
    own = enlarge(started.assembly, ("cubic_stiffness",))
    state = step.result.refitted.fit_state
    label = state.labels[-1]
    finish = whole_fit.finish_fit

    def search(assembly, fit, progress, anew=False):
        if not astray:
            return finish(assembly, fit, progress, anew)
        values = fit.state.values.copy()
        values[:, assembly.study.keys.index(STIFFNESS)] *= 1.2
        moved = replace(fit.state, values=values, held=(STIFFNESS,))
        return fit_by_likelihood(assembly, moved, rough=True)

    monkeypatch.setattr(whole_fit, "finish_fit", search)
    said = []
    whole = whole_fit.fit_with_effect(own, state, label, said.append, objection=lambda whole: None)
    assert any("noise model as it was" in m for m in said) == astray
    told = whole.refitted.comparison.model.estimates()["linear_stiffness"]["stiffness"]
    assert np.isclose(told.estimate, VALUES[STIFFNESS], atol=4 * told.se)
    assert whole.complete
