"""Jobs and plans for the tests of sweeps, where worker processes can import them."""

import os
import signal
import time
from pathlib import Path

from spiral.io.sweeps.jobs import plan_sweep

RECORD = (
    "system=oscillator", "record=simulation", "record.duration=1", "record.rate=500",
    "record.inputs={force: {noise: 1.0, band: [2, 30]}}",
    "record.values={system.mass: 1, linear_stiffness.stiffness: 4e3, linear_damping.damping: 4}",
)  # fmt: skip


def plan_of(registry, *words, verb="compare"):
    return plan_sweep(verb, (), ["holdout=0.2,0.3,0.4,0.5", *words], None, registry)


def value_of(overrides, key="holdout"):
    return next(t.partition("=")[2] for t in overrides if t.startswith(f"{key}="))


def echo(verb, names, overrides, plugins):
    """A job that says what it was given, or does as its ``out`` says."""
    value = value_of(overrides)
    what = value_of(overrides, "out")
    if what == "broken" and value == "0.3":
        raise ZeroDivisionError("a defect")
    if what == "killed" and value == "0.3":
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "once" and value == "0.3" and not Path("died").exists():
        Path("died").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "slow":
        time.sleep(0.0 if value == "0.2" else 60)
    return 0, {"value": value, "run_id": f"run-{value}", "process": os.getpid()}


def lost(verb, names, overrides, plugins):
    """A job for which a process (``fixed`` names it) goes away on the third value."""
    if value_of(overrides) == "0.4":
        os.kill(int(value_of(overrides, "fixed")), signal.SIGKILL)
        time.sleep(30)
    return 0, {}


def without_clock(value):
    """A result less what differs between two runs of one job: times and ids."""
    if isinstance(value, dict):
        own = {k: v for k, v in value.items() if k not in ("seconds", "run_id", "created")}
        return {k: without_clock(v) for k, v in own.items()}
    return [without_clock(v) for v in value] if isinstance(value, list) else value
