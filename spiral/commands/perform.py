"""Carry out one request of the command line and return its outcome; nothing is printed.

The same function serves the terminal, ``--json`` and the workers of a sweep.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from spiral.commands.ram import out_of_memory_error
from spiral.io.request import BAD_INPUT, Outcome, Request, compose_request
from spiral.types.errors import ConfigError, SpiralError

if TYPE_CHECKING:
    from spiral.commands.study import OnRound, SoFar, Tell


def perform(
    request: Request, tell: Tell, on_round: OnRound | None = None, so_far: SoFar | None = None
) -> Outcome:
    """Carry out one request; ``so_far`` is given what a study knows while it goes on.

    Raises
    ------
    SpiralError : bad input; the caller makes it exit 2.
    """
    from spiral.commands import estimate, export, planning, plugins, report, study
    from spiral.io.custom import registry_for_config
    from spiral.io.programs import programs_named
    from spiral.io.registry import load_registry

    if request.verb == "new":
        return plugins.create_plugin(request)
    if request.verb == "report":
        return report.report(request, tell)
    programs = programs_named(request.overrides, request.names)
    registry = replace(load_registry(request.plugins), programs=programs)
    if request.verb == "plugins":
        return plugins.list_plugins(request, registry)
    if request.verb == "check":
        return plugins.check_plugins(request, registry, tell)
    for failure in registry.failures:
        tell(f"not usable: {failure.name} in {failure.file}: {failure.message}")
    if request.verb == "export":
        return export.export(request, registry, tell)
    config = compose_request(request, registry)
    registry = registry_for_config(config, registry)
    steps = {
        "discover": study.discover, "compare": study.compare, "diagnose": study.diagnose,
        "add": study.add, "estimate": estimate.reconstruct_states, "identify": planning.identify,
        "plan": planning.plan,
    }  # fmt: skip
    if request.verb == "simulate":
        return study.simulate(request, config, registry)
    if request.names and request.verb not in ("add", "plan"):
        raise _needless_names_error(request)
    tell("reading the records")
    asked = study.Command(request, config, registry, tell, on_round, so_far)
    return report.run_and_save_curves(asked, steps[request.verb])


def _needless_names_error(request: Request) -> ConfigError:
    return ConfigError(
        f"{request.verb} {' '.join(request.names)}",
        f"{request.verb} with overrides KEY=VALUE",
        f"spiral add {request.names[0]}, or effect=[{request.names[0]}]",
    )


def perform_sweep_job(
    verb: str, names: tuple[str, ...], overrides: tuple[str, ...], plugins: str | None
) -> tuple[int, dict[str, Any]]:
    """Carry out one request as a job of a sweep; returns exit code and result."""
    try:
        outcome = perform(Request(verb, names, overrides, plugins), lambda message: None)
    except SpiralError as error:
        return BAD_INPUT, {"error": error.as_dict()}
    except MemoryError:
        return BAD_INPUT, {"error": out_of_memory_error().as_dict()}
    return outcome.exit, outcome.result
