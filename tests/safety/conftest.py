"""What the tests of hostile inputs share: a plugin that says when it ran, a saved run, a meter.

Every test marked ``hostile`` is measured; the last lines of a run of this folder say how many
inputs of which kind were tried, and which took longest and most memory.
"""

import os
import re
import zipfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from spiral.io.config import build_problem, compose
from spiral.io.registry import load_registry
from spiral.io.storage import save_run
from spiral.types.run import ChannelError, Comparison, Round, Run

SECONDS, BYTES = 30.0, 2 * 10**9  # of a processor and of memory that an input may take
MEASURED = "hostile"  # property of a test's report: kind, s, bytes
COLLECTED = pytest.StashKey[tuple[Counter, set]]()  # hostile inputs by kind; files of tests
STATUS, PEAK = Path("/proc/self/status"), Path("/proc/self/clear_refs")  # of Linux

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


def flood(file, count, kind="<f8"):
    """An NPZ of so many zeros, small until it is unpacked."""
    head = {"descr": kind, "fortran_order": False, "shape": (count,)}
    left, block = count * np.dtype(kind).itemsize, bytes(10**7)
    packed = zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
    with packed, packed.open("x.npy", "w", force_zip64=True) as target:
        np.lib.format.write_array_header_1_0(target, head)
        while left > 0:
            target.write(block[:left])
            left -= len(block)


def largest_child():
    """Most memory, in bytes, that any process started by this one has taken."""
    import resource

    return 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss


def processor_time():
    """Of this process and those that it started and that have ended, in s."""
    return sum(os.times()[:4])


def memory(name):
    """Of this process, in bytes: ``VmRSS`` is what it holds, ``VmHWM`` the most it has held."""
    return 1024 * int(re.search(rf"{name}:\s+(\d+)", STATUS.read_text())[1])


FRESH = memory("VmRSS") if STATUS.exists() else 0  # interpreter and libraries, before any test


@pytest.fixture(autouse=True)
def measured(request, record_property):
    """Processor time and memory of a test marked ``hostile``, with interpreter and libraries.

    What tests before it have left in this process is not counted.
    """
    mark = request.node.get_closest_marker("hostile")
    if mark is None or not PEAK.exists():
        yield
        return
    PEAK.write_text("5")  # the peak starts anew
    began, before = processor_time(), largest_child()
    left = max(memory("VmRSS") - FRESH, 0)
    yield
    seconds, child = processor_time() - began, largest_child()
    taken = max(memory("VmHWM") - left, child if child > before else 0)
    record_property(MEASURED, (mark.args[0], seconds, taken))
    assert seconds < SECONDS
    assert taken < BYTES


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Note the hostile inputs, and in which files tests are, before slow ones are left out."""
    kinds = [mark.args[0] for item in items for mark in item.iter_markers("hostile")]
    config.stash[COLLECTED] = Counter(kinds), {item.path.name for item in items}


@pytest.fixture
def collected(request):
    """Hostile inputs by kind, slow ones too, and the names of the files that tests are from."""
    return request.config.stash[COLLECTED]


def pytest_terminal_summary(terminalreporter):
    """How many hostile inputs were tried, and the most that one took."""
    found = [
        (*value, report.nodeid.rpartition("::")[2])
        for reports in terminalreporter.stats.values()
        for report in reports
        if getattr(report, "when", "") == "teardown"
        for name, value in report.user_properties
        if name == MEASURED
    ]
    if not found:
        return
    kinds = Counter(kind for kind, *_ in found)
    longest, largest = max(found, key=lambda f: f[1]), max(found, key=lambda f: f[2])
    listed = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
    terminalreporter.write_line(
        f"hostile inputs: {len(found)} ({listed})\n"
        f"  most processor time {longest[1]:.1f} s ({longest[3]})\n"
        f"  most memory {largest[2] / 1e9:.2f} GB ({largest[3]})"
    )
