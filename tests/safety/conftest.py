"""What the tests of hostile files share: a plugin that says when it ran, and a saved run."""

from dataclasses import replace

import pytest

from spiral.io.config import build_problem, compose
from spiral.io.registry import load_registry
from spiral.io.storage import save_run
from spiral.types.run import ChannelError, Comparison, Round, Run

OVERRIDES = ("experiment=rotor_coastdown", "record.duration=0.2")

PLUGIN = '''
from pathlib import Path

from spiral.types.effect import ForceEffect
from spiral.types.parameter import Parameter

Path({trace!r}).write_text("ran")


class OwnSpring(ForceEffect):
    """A spring of one's own: F = -k q."""

    parameters = (Parameter("stiffness", "force/position"),)

    def force(self, at, u, p):
        return [-p.stiffness * q for q in at.position]
'''


@pytest.fixture
def trace(tmp_path):
    """The file that a hostile text writes where it is run."""
    return tmp_path / "it-ran"


@pytest.fixture
def plugin(trace):
    """Text of a plugin that leaves a trace where it is run."""
    return PLUGIN.format(trace=str(trace))


@pytest.fixture(scope="session")
def question():
    """A composed configuration and its problem, without any fit."""
    registry = load_registry(local=False)
    config = compose(OVERRIDES, registry)
    return config, build_problem(config, registry)


def saved(question, folder, registry=None, effects=()):
    """The folder of a run saved as by ``discover``, its model with these effects added."""
    config, problem = question
    model = replace(problem.model, effects=(*problem.model.effects, *effects))
    keys = [k for k, _ in model.pairs]
    model = replace(model, values=dict.fromkeys(keys, 1.0), errors=dict.fromkeys(keys, 0.1))
    channels = {"x": ChannelError(1e-6, 0.02), "y": ChannelError(1e-6, 0.02)}
    comparison = Comparison(model, 0.1, 0.2, channels, 0.02, 1.0, 0.5, 0.0, 64, True)
    rounds = (Round(0, (), {}, {}, (), comparison, 1.0),)
    run = Run("nothing_missing", "whiteness", rounds, model, "advice")
    data = {"records": problem.records, "test": problem.test}
    known = registry or load_registry(local=False)
    return folder / save_run(run, config, data, known, folder).run_id
