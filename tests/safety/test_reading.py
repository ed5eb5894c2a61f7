"""Reading a file on the page: limited in time and memory, and cancelled by a click."""

import queue
import threading
from pathlib import Path

import numpy as np
import pytest

from spiral.app import record_setup as kept
from spiral.app.file_setup import FileSetup
from spiral.app.processes import Process


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """A folder of runs, the page's own process of the fits, and what it tells."""
    out, told = tmp_path_factory.mktemp("page"), queue.Queue()
    process = Process("fits", out, lambda order, kind, data: told.put((order, kind, data)))
    yield out, process, told
    process.close()


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    """A file that takes some seconds and 100 MB to read."""
    file = tmp_path_factory.mktemp("large") / "large.csv"
    rows = "".join(f"{i}.5,{i}.25,{i}.125,{i}\n" for i in range(50_000))
    file.write_text("t,a,b,c\n" + 20 * rows)
    return file


def order(out, file, **more):
    folder = out / "studies" / "uploads" / "0000-test"
    folder.mkdir(parents=True, exist_ok=True)
    return {"do": "describe_file", "study": "0000-test", "overrides": [], "plugins": None,
            "path": str(file), "folder": str(folder), **more}  # fmt: skip


def ended(told):
    """How an order ended."""
    while True:
        _, kind, data = told.get(timeout=300)
        if kind in ("done", "failed", "cancelled"):
            return kind, data


def test_what_takes_too_long_is_ended_and_said(page, large):
    out, process, told = page
    process.give(order(out, large, seconds=0.2))
    kind, data = ended(told)
    assert kind == "failed"
    assert "had not ended after 0 s" in data["given"]


def test_what_takes_too_much_memory_is_refused(page, large):
    out, process, told = page
    process.give(order(out, large, memory=60_000_000))
    kind, data = ended(told)
    assert kind == "failed"
    assert "0.06 GB of memory" in data["given"]


def test_reading_is_cancelled_and_the_next_file_is_read(page, large, tmp_path):
    out, process, told = page
    small = tmp_path / "small.csv"
    np.savetxt(small, np.ones((10, 2)), delimiter=",", header="t,x", comments="")
    process.give(order(out, large))
    assert told.get(timeout=300)[1] == "progress"
    assert process.cancel("0000-test")
    assert ended(told) == ("cancelled", {})
    process.give(order(out, small, seconds=60.0, memory=10**10))
    assert ended(told) == ("done", {})


def test_every_order_about_a_file_has_its_limits_and_a_cancelled_one_says_so(tmp_path):
    orders = []
    setups = FileSetup(tmp_path, orders.append, lambda ident: None, None, threading.RLock())
    setup = setups.create_setup("a.csv")
    Path(setup.path).write_bytes(bytes(10**6))
    setups.read_arrived_file(setup)
    assert orders[0]["seconds"] == 31.0  # and so a small hostile file takes 30 s at most
    assert orders[0]["memory"] == 1_512_000_000  # beside half a GB of the process itself
    setups.on_event(orders[0], "cancelled", {})
    assert "Cancelled: reading the file" in setups.current_file(setup.ident).setup.trouble["given"]
    assert setups.current_file(setup.ident).busy == ""
    assert kept.load_setup(tmp_path, setup.ident).trouble is not None
