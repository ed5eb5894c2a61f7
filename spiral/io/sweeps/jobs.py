"""The plan of a sweep: its jobs, where they run, and the fingerprint that identifies it.

Two starts are the same sweep where verb, names, jobs, plugins' versions, this program's version,
the presets and the files of measurements (size and time of change) are the same. ``n_jobs`` and
``sweep.*`` may differ: where jobs run does not matter to what comes of them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from spiral.io.sweeps.pool import Backend, Job
from spiral.types.errors import ConfigError, SpiralError
from spiral.version import __version__

if TYPE_CHECKING:
    from spiral.io.config import Config
    from spiral.io.registry import Registry

_ABOUT_FILES = ("experiment", "run", "out", "record", "test", "record.path", "test.path")
_OF_ALL = ("sweep", "tracking")


@dataclass(frozen=True)
class SweepOptions:
    """The fields of ``sweep``: where jobs run, and whether to take up what is there.

    Parameters
    ----------
    backend : ``loky``, processes of this machine, or ``dask``, the workers of a cluster.
    address : the Dask scheduler's, ``tcp://HOST:PORT``.
    timeout : s to wait for the scheduler and its first worker.
    resume : take up the last sweep of the same jobs where it is not done.
    id : the sweep that a job belongs to; the sweep itself says so to its jobs.
    """

    backend: Literal["loky", "dask"] = "loky"
    address: str | None = None
    timeout: float = 10.0
    resume: bool = True
    id: str | None = None


@dataclass(frozen=True)
class SweepPlan:
    """A sweep before it starts.

    ``calls`` are the jobs as workers are sent them; ``config`` is what holds for all of them:
    where they run, where they are kept, how they are tracked.
    """

    verb: str
    names: tuple[str, ...]
    jobs: tuple[Job, ...]
    calls: tuple[Job, ...]
    plugins: str | None
    out: str
    options: SweepOptions
    backend: Backend
    fingerprint: str
    config: Mapping[str, Any]


def plan_sweep(
    verb: str,
    names: tuple[str, ...],
    overrides: Sequence[str],
    plugins: str | None,
    registry: Registry,
) -> SweepPlan:
    """The plan of a sweep: one job for every combination of the values given, in order.

    Raises
    ------
    ConfigError : overrides that do not parse, or a bad value of ``sweep`` or ``n_jobs``.
    """
    from spiral.io.config import top_level_options
    from spiral.io.overrides import expand_sweep
    from spiral.types.fields import construct

    jobs = expand_sweep(overrides)
    config = _sweep_configuration(jobs[0], registry)
    chosen = construct(SweepOptions, config["sweep"], "sweep")
    n_jobs = top_level_options(config).n_jobs
    if n_jobs == 0 or chosen.timeout <= 0:
        given = f"n_jobs={n_jobs}" if n_jobs == 0 else f"sweep.timeout={chosen.timeout:g}"
        raise ConfigError(given, "a number above zero; n_jobs=-1 is one for each processor")
    backend = Backend(chosen.backend, chosen.address, n_jobs, chosen.timeout)
    calls = tuple(_prepare_job(job) for job in jobs)
    out = str(config["out"])
    fingerprint = _sweep_fingerprint(verb, names, calls, registry)
    return SweepPlan(verb, names, jobs, calls, plugins, out, chosen, backend, fingerprint, config)


def override_key(text: str) -> str:
    """The key of an override."""
    return text.partition("=")[0].lstrip("+~")


def _sweep_configuration(job: Job, registry: Registry) -> Config:
    """The configuration as far as it says where jobs run and rows are kept."""
    from spiral.io.config import compose

    own = [
        t
        for t in job
        if override_key(t) in ("n_jobs", "out") or override_key(t).startswith(_OF_ALL)
    ]
    preset = [t for t in job if override_key(t) == "experiment"]
    try:
        return compose([*preset, *own], registry)
    except ConfigError:
        return compose(own, registry)  # a preset that is not there is the jobs' own affair


def _prepare_job(job: Job) -> Job:
    """A job for a worker: without ``sweep.*``, and ``run=latest`` as the run it is now."""
    from spiral.io.storage import load_run

    given = {override_key(t): t.partition("=")[2] for t in job}
    rest = tuple(t for t in job if not override_key(t).startswith("sweep."))
    if not given.get("run"):
        return rest
    try:
        run_id = load_run(given["run"], given.get("out") or "runs").run_id
    except SpiralError:
        return rest
    return tuple(f"run={run_id}" if override_key(t) == "run" else t for t in rest)


def _sweep_fingerprint(
    verb: str, names: tuple[str, ...], jobs: Sequence[Job], registry: Registry
) -> str:
    same = [[t for t in job if override_key(t) != "n_jobs"] for job in jobs]
    content = [verb, names, same, registry.versions(), __version__, _input_states(same, registry)]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _input_states(jobs: Sequence[Sequence[str]], registry: Registry) -> list[Any]:
    """Presets as composed, and the files that jobs read with size and time of change."""
    from spiral.io.request import Request, compose_request

    states = []
    for job in dict.fromkeys(
        tuple(t for t in job if override_key(t) in _ABOUT_FILES) for job in jobs
    ):
        try:
            config = compose_request(Request("compare", overrides=job), registry)
        except SpiralError:  # the job will say so itself
            continue
        files = [
            _file_state(path)
            for group in ("record", "test")
            for path in _source_paths(config, group)
        ]
        states.append([{k: v for k, v in config.items() if k not in ("n_jobs", "sweep")}, files])
    return json.loads(json.dumps(states, default=str))


def _source_paths(config: Config, group: str) -> list[str]:
    given = (config.get(group) or {}).get("path") or []
    return [given] if isinstance(given, str) else [str(path) for path in given]


def _file_state(path: str) -> list[Any]:
    from spiral.io.readers.table import find_file

    try:
        file = find_file(path).stat()
    except (SpiralError, OSError):
        return [path, None]
    return [path, file.st_size, file.st_mtime_ns]
