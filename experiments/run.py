"""A plain Hydra application around ``discover``, for Hydra's own launchers and sweepers.

    python experiments/run.py experiment=rotor_coastdown
    python experiments/run.py -m experiment=rotor_coastdown record.seed=0,1,2,3

It returns the test error of the final model, so a sweeper can minimise it. Hydra composes first
and is stricter than ``spiral discover``: a field of a test record that no preset chose is
written ``+test.FIELD=VALUE``, and beside a swept preset (``experiment=a,b``) a field of the record
``++record.FIELD=VALUE``: Hydra checks overrides once before it looks at the presets.
"""

from __future__ import annotations

import hydra
from omegaconf import DictConfig

from spiral.config import build_problem, compose, register
from spiral.registry import load_registry

REGISTRY = load_registry()
register(REGISTRY)


@hydra.main(config_path="pkg://spiral_conf", config_name="config", version_base="1.3")
def main(_: DictConfig) -> float:
    """Discover what is missing; the relative free-run error on the test record."""
    from hydra.core.hydra_config import HydraConfig

    from spiral.discover import discover
    from spiral.storage import save_run

    config = compose(list(HydraConfig.get().overrides.task), REGISTRY)
    problem = build_problem(config, REGISTRY)
    run = discover(problem, print)
    data = {"records": problem.records, "test": problem.test}
    named = save_run(run, config, data, REGISTRY, config["out"])
    print(f"{named.run_id}: {', '.join(run.model.labels)}, test error {run.final.test_error:.4f}")
    return run.final.test_error


if __name__ == "__main__":
    main()
