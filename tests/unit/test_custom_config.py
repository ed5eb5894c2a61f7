"""``effect.NAME.expression=``: a plugin for one study, kept with its run."""

import json

import pytest

from spiral.cli import main
from spiral.io.config import build_model, build_problem, compose, top_level_options
from spiral.io.custom import registry_for_config
from spiral.io.overrides import expand_sweep, parse_overrides
from spiral.io.problem_setup import candidates_for
from spiral.io.registry import load_registry
from spiral.io.storage import load_run, model_data, rebuild_model
from spiral.types.errors import ConfigError

REGISTRY = load_registry()
SWING = (
    "system=oscillator", "record=simulation", "record.duration=4", "record.rate=100",
    "record.inputs={force: {noise: 20, band: [0.5, 6]}}", "record.effects=[cubic_stiffness]",
    "record.values={system.mass: 1, linear_stiffness.stiffness: 400, linear_damping.damping: 1, "
    "cubic_stiffness.stiffness: 30000}", "tracking.enabled=false",
)  # fmt: skip
DENT = "+effect.dent.expression=-k3*x**3"


def composed(*more):
    return compose((*SWING, *more), REGISTRY)


def candidates(config):
    model = build_model(config, REGISTRY)
    return [
        e.label
        for e in candidates_for(
            registry_for_config(config, REGISTRY), model, top_level_options(config).candidates
        )
    ]


def test_it_is_a_candidate_and_joins_the_model_where_it_is_named():
    config = composed(DENT)
    assert "dent" in candidates(config)
    assert candidates(composed(DENT, "candidates=[dent,quadratic_damping]"))[0] == "dent"
    for named in ("effect=[dent]", "seed=[linear_stiffness,linear_damping,dent]"):
        config = composed(DENT, named)
        assert "dent" in build_model(config, REGISTRY).labels
        assert "dent" not in candidates(config)
    assert "dent" in candidates(composed(DENT, "effect=[dent]", "~effect.dent"))


def test_several_with_fields_in_any_order():
    config = composed(
        "effect.drag.grid.w=[0.1,0.3]", "+effect.drag.expression=-F*tanh(v/w)", DENT,
        "effect.drag.lower={F: 0}", "effect.dent.meaning=A dent in the spring",
    )  # fmt: skip
    known = registry_for_config(config, REGISTRY)
    level, width = known.effect_from_label("drag").parameters
    assert (level.lower, width.grid, width.role) == (0, (0.1, 0.3), "shape")
    assert known.effect_from_label("dent").meaning() == "A dent in the spring: F_x = -k3*x**3."
    assert known.versions()["effect/dent"].startswith("expression ")


def test_a_formula_needs_no_quotes_and_is_swept():
    (item,) = parse_overrides(("effect.rub.expression=-F*tanh(v/w) + c*maximum(x, 0)",))
    assert item.value == "-F*tanh(v/w) + c*maximum(x, 0)"
    assert [j[0] for j in expand_sweep(("effect.d.expression=-k*maximum(x,0),-k*x**3",))] == [
        'effect.d.expression="-k*maximum(x,0)"', 'effect.d.expression="-k*x**3"'
    ]  # fmt: skip
    (item,) = parse_overrides(("effect.d.expression.x=-k*tanh(y/w)",))
    assert item.value == "-k*tanh(y/w)"


@pytest.mark.parametrize("value", ["t [s]", "run (2).csv", "level {upper}", "it's"])
def test_a_name_with_brackets_needs_no_quotes(value):
    (item,) = parse_overrides((f"record.time={value}",))
    assert item.value == value


def test_a_list_that_does_not_close_is_no_name():
    with pytest.raises(ConfigError, match="quote values"):
        parse_overrides(("free=[a, b",))


def test_a_plugins_name_is_refused_and_a_typo_is_still_one():
    with pytest.raises(ConfigError, match=r"effect\.my_cubic_stiffness"):
        composed("effect.cubic_stiffness.expression=-k*x**3")
    with pytest.raises(ConfigError, match="cubic_stiffness"):
        composed("effect=[cubic_stifness]")
    with pytest.raises(ConfigError, match="expresion"):
        composed(DENT, "effect.dent.expresion=-k*x")


def test_a_saved_model_holds_its_formulas():
    model = build_model(composed(DENT, "effect=[dent]"), REGISTRY)
    saved = json.loads(json.dumps(model_data(model)))
    assert rebuild_model(saved, REGISTRY) == model


def test_a_run_is_taken_up_with_its_formula(tmp_path, capsys):
    given = (*SWING, DENT, f"out={tmp_path}", "candidates=[dent,quadratic_damping]")
    assert main(["discover", *given]) == 0
    assert "-k3*x**3" in capsys.readouterr().out
    run = load_run("latest", tmp_path)
    assert run.result["rounds"][1]["admitted"] == ["dent"]
    found = run.result["model"]["effects"]["dent"]["k3"]
    assert abs(found["estimate"] - 3e4) < 4 * found["se"]
    assert found["unit"] == "N/m^3"
    again = build_problem(run.as_config(), REGISTRY).model
    assert (again.effects, again.values) == (
        run.model(REGISTRY).effects,
        run.model(REGISTRY).values,
    )
    assert main(["compare", "run=latest", f"out={tmp_path}"]) == 0


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("x**3", ["x**3", "m^3", "N"]),
        ("-k*x.__class__", ["x.__class__", "sqrt"]),
        ("-k*(x", ["was never closed"]),
        ("-k*x + k*x_rate", ["one unit"]),
    ],
)
def test_a_bad_formula_is_one_message_and_exit_2(value, words, capsys):
    assert main(["compare", *SWING, f"effect.dent.expression={value}"]) == 2
    told = capsys.readouterr().err
    assert all(word in told for word in words)
    assert told.count("given:") == 1
    assert "Traceback" not in told
