"""The group ``strategy=``: options from a configuration, and what each does on a small study."""

from dataclasses import replace

import pytest
from spiral_plugins.gates.joint import PartialF
from spiral_plugins.learners.boosted_trees import BoostedTrees
from spiral_plugins.strategies.innovation import Innovation
from spiral_plugins.strategies.likelihood import Likelihood
from spiral_plugins.strategies.paper import Paper
from spiral_plugins.strategies.shooting import Shooting

from spiral.inference.compare import compare
from spiral.inference.discover import add, discover
from spiral.inference.problem import silent
from spiral.io.config import compose
from spiral.io.conformance.strategies import rehearsal
from spiral.io.registry import load_registry
from spiral.io.strategy_config import build_strategy
from spiral.types.errors import ConfigError
from tests.scenes import effect, registry

REGISTRY = registry()
OPTIONS = ("gate=[partial_f]", "gate.partial_f.alpha=0.2", "learner=boosted_trees")
OWN = '''
from spiral_plugins.gates.robust import HacT
from spiral.engine.gate import Gate
from spiral.inference.strategies.base import Strategy


class OneGate(Strategy):
    """Evidence of one gate: t = theta / se."""

    gate: tuple[Gate, ...] = (HacT(),)
    share: float = 0.1

    def begin(self, problem, progress): ...
    def propose(self, assembly, fit_state, comparison, number, progress): ...
    def settle(self, assembly, step, progress): ...
'''


def built(*overrides, base=None):
    return build_strategy(compose(overrides, REGISTRY, base), REGISTRY)


def test_the_options_of_a_configuration_are_the_fields_of_the_plugin():
    asked = Paper(gate=(PartialF(alpha=0.2),), learner=BoostedTrees(), points=2000, train=0.6)
    assert built("strategy=paper", *OPTIONS, "strategy.points=2000", "paper.train=0.6") == asked
    assert built() == Likelihood()
    assert built("strategy=innovation") == Innovation()


def test_a_run_saved_before_strategies_had_options_is_taken_up():
    config = compose(("strategy=paper", *OPTIONS), REGISTRY)
    sampling = {"train": 0.6, "split": "tail", "sampling": "box", "points": 2000, "seed": 3}
    old = {**config, "strategy": "paper", "paper": sampling}
    found = built(base=old)
    assert found == Paper(gate=(PartialF(alpha=0.2),), learner=BoostedTrees(), **sampling)
    assert built(base={**old, "strategy": "likelihood"}) == Likelihood()


def test_a_strategy_of_ones_own_takes_the_options_it_has_fields_for(tmp_path):
    (tmp_path / "one_gate.py").write_text(OWN)
    mine = load_registry(tmp_path)
    config = compose(("strategy=one_gate", "gate=[partial_f]", "one_gate.share=0.3"), mine)
    found = build_strategy(config, mine)
    assert (found.gate, found.share) == ((PartialF(),), 0.3)
    with pytest.raises(ConfigError, match="can add what a person names"):
        add(rehearsal(found, mine), (effect("cubic_stiffness"),))
    with pytest.raises(ConfigError, match="not an option of strategy=one_gate"):
        compose(("strategy=one_gate", "library=core"), mine)


def test_an_option_is_the_one_that_the_steps_use():
    """Two candidates are scored; as many as asked for are told, the best first."""
    found = [discover(rehearsal(Shooting(listed=n), REGISTRY)).rounds[0] for n in (1, 5)]
    told = [[s.effect for s in first.suggestions] for first in found]
    assert told == [["cubic_stiffness"], ["cubic_stiffness", "quadratic_damping"]]


QUICK = Paper(learner=BoostedTrees())


@pytest.mark.parametrize("strategy", [Innovation(), QUICK], ids=["innovation", "paper"])
def test_compare_and_add_fit_as_the_strategy_does(strategy):
    """A cubic spring of 3e7 N/m^3 that the model lacks; the paper's derivatives bias it."""
    asked = rehearsal(strategy, REGISTRY)
    begun = strategy.begin(replace(asked, candidates=()), silent)
    assert compare(asked).fit_error == begun.comparison.fit_error
    before, after, run = add(asked, (effect("cubic_stiffness"),))
    assert after.test_error < 0.2 * before.test_error
    assert run.model.values["cubic_stiffness.stiffness"] == pytest.approx(3e7, rel=0.05)
    if isinstance(strategy, Paper):
        with pytest.raises(ConfigError, match="its own candidates"):
            add(asked, (effect("jenkins"),))
