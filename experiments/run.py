"""A plain Hydra application around ``discover``, for Hydra's own launchers and sweepers.

    python experiments/run.py experiment=rotor_coastdown
    python experiments/run.py -m experiment=rotor_coastdown record.seed=0,1,2,3

It returns the test error of the final model, so a sweeper can minimise it, and tells MLflow; jobs
of a launcher that runs them side by side wait for one another there. Hydra composes first and is
stricter than ``spiral discover``: a field of a test record that no preset chose is written
``+test.FIELD=VALUE``, and beside a swept preset (``experiment=a,b``) a field of the record
``++record.FIELD=VALUE``: Hydra checks overrides once before it looks at the presets.
"""

from __future__ import annotations

import hydra
from omegaconf import DictConfig

from spiral.io.config import register_with_hydra
from spiral.io.registry import load_registry

REGISTRY = load_registry()
register_with_hydra(REGISTRY)


@hydra.main(config_path="pkg://spiral_conf", config_name="config", version_base="1.3")
def main(_: DictConfig) -> float:
    """Discover what is missing; the relative free-run error on the test record."""
    from hydra.core.hydra_config import HydraConfig

    from spiral.commands.perform import perform
    from spiral.io.request import Request
    from spiral.io.tracking.store import tracking_options
    from spiral.io.tracking.track import track
    from spiral.view.report.html import report_html

    given = tuple(HydraConfig.get().overrides.task)
    outcome = perform(Request("discover", overrides=given), print)
    config, result = outcome.parts["config"], outcome.result
    how, wanted, known = tracking_options(config), (result["run_id"],), outcome.parts["registry"]
    tracked = track(how, config["out"], wanted, catch_up=False, draw=report_html, registry=known)
    if tracked.failure is not None:
        print(f"saved, but not told to MLflow: {tracked.failure}")
    error = result["rounds"][-1]["test_error"]
    found = ", ".join(result["model"]["effects"])
    print(f"{result['run_id']}: {found}, test error {error:.4f}")
    return error


if __name__ == "__main__":
    main()
