"""What a sweep is asked: its jobs, where they run, and what tells it from another.

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


def planned(
    verb: str,
    names: tuple[str, ...],
    overrides: Sequence[str],
    plugins: str | None,
    registry: Registry,
) -> SweepPlan:
    """Every combination of the values given, in order.

    Raises
    ------
    ConfigError : overrides that do not parse, or a bad value of ``sweep`` or ``n_jobs``.
    """
    from spiral.io.config import options
    from spiral.io.overrides import expand
    from spiral.types.fields import construct

    jobs = expand(overrides)
    config = _about_the_sweep(jobs[0], registry)
    chosen = construct(SweepOptions, config["sweep"], "sweep")
    n_jobs = options(config).n_jobs
    if n_jobs == 0 or chosen.timeout <= 0:
        given = f"n_jobs={n_jobs}" if n_jobs == 0 else f"sweep.timeout={chosen.timeout:g}"
        raise ConfigError(given, "a number above zero; n_jobs=-1 is one for each processor")
    backend = Backend(chosen.backend, chosen.address, n_jobs, chosen.timeout)
    calls = tuple(_settled(job) for job in jobs)
    out = str(config["out"])
    found = _fingerprint(verb, names, calls, registry)
    return SweepPlan(verb, names, jobs, calls, plugins, out, chosen, backend, found, config)


def key_of(text: str) -> str:
    """The key of an override."""
    return text.partition("=")[0].lstrip("+~")


def _about_the_sweep(job: Job, registry: Registry) -> Config:
    """The configuration as far as it says where jobs run and rows are kept."""
    from spiral.io.config import compose

    own = [t for t in job if key_of(t) in ("n_jobs", "out") or key_of(t).startswith(_OF_ALL)]
    preset = [t for t in job if key_of(t) == "experiment"]
    try:
        return compose([*preset, *own], registry)
    except ConfigError:
        return compose(own, registry)  # a preset that is not there is the jobs' own affair


def _settled(job: Job) -> Job:
    """A job for a worker: without ``sweep.*``, and ``run=latest`` as the run it is now."""
    from spiral.io.storage import load_run

    given = {key_of(t): t.partition("=")[2] for t in job}
    rest = tuple(t for t in job if not key_of(t).startswith("sweep."))
    if not given.get("run"):
        return rest
    try:
        found = load_run(given["run"], given.get("out") or "runs").run_id
    except SpiralError:
        return rest
    return tuple(f"run={found}" if key_of(t) == "run" else t for t in rest)


def _fingerprint(verb: str, names: tuple[str, ...], jobs: Sequence[Job], registry: Registry) -> str:
    same = [[t for t in job if key_of(t) != "n_jobs"] for job in jobs]
    content = [verb, names, same, registry.versions(), __version__, _inputs(same, registry)]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _inputs(jobs: Sequence[Sequence[str]], registry: Registry) -> list[Any]:
    """Presets as composed, and the files that jobs read with size and time of change."""
    from spiral.io.request import Request, configured

    found = []
    for job in dict.fromkeys(tuple(t for t in job if key_of(t) in _ABOUT_FILES) for job in jobs):
        try:
            config = configured(Request("compare", overrides=job), registry)
        except SpiralError:  # the job will say so itself
            continue
        files = [_state(path) for group in ("record", "test") for path in _paths(config, group)]
        found.append([{k: v for k, v in config.items() if k not in ("n_jobs", "sweep")}, files])
    return json.loads(json.dumps(found, default=str))


def _paths(config: Config, group: str) -> list[str]:
    given = (config.get(group) or {}).get("path") or []
    return [given] if isinstance(given, str) else [str(path) for path in given]


def _state(path: str) -> list[Any]:
    from spiral.io.readers.files import find_file

    try:
        file = find_file(path).stat()
    except (SpiralError, OSError):
        return [path, None]
    return [path, file.st_size, file.st_mtime_ns]
