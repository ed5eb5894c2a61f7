"""Studies by their figures alone, for tests of what is said of them."""

from dataclasses import replace

from spiral_plugins.systems.oscillator import Oscillator

from spiral.inference.advice import advice_for
from spiral.inference.problem import Settings
from spiral.inference.verdict import (
    study_summary,
    study_verdict,
)
from spiral.types.horizon import Horizon
from spiral.types.model import Model, seed_model
from spiral.types.run import Comparison, Round
from tests.scenes import effect

SETTINGS = Settings()


def model(*effects, **estimates):
    """An oscillator with effects; ``NAME__parameter=(value, error)``."""
    base = seed_model(Oscillator())
    keys = {k.replace("__", "."): v for k, v in estimates.items()}
    return Model(
        base.system,
        (*base.effects, *effects),
        values={k: v for k, (v, _) in keys.items()},
        errors={k: e for k, (_, e) in keys.items()},
    )


CUBIC = effect("cubic_stiffness")
TOLD = model(CUBIC, cubic_stiffness__stiffness=(3.0, 0.1))
GOOD = Comparison(TOLD, 0.02, 0.0201, {}, 0.02, 1.01, 0.4, 0.003, 1024, True)
POOR = replace(GOOD, model=seed_model(Oscillator()), fit_error=0.5, test_error=0.6,
               chi2_per_dof=900.0, whiteness_p=0.0, whiteness_effect=8.0)  # fmt: skip


def rounds(last, first=POOR):
    return (Round(0, (), {}, {}, (), first, 1.0),
            Round(1, ("cubic_stiffness",), {}, {}, (), last, 1.0))  # fmt: skip


def said(found, stopped="no_candidate"):
    verdict = study_verdict(found, stopped, SETTINGS)
    words = study_summary(found, verdict, stopped, SETTINGS)
    return verdict, words, advice_for(verdict, stopped, found, (), SETTINGS)


def ahead(error):
    """An error some time ahead, the same in every block."""
    return Horizon("ahead", 5, 0.5, {"x": (error**2,) * 5})
