"""Tests that ``spiral new`` writes, run by pytest in this process, which has its imports."""

import sys
from pathlib import Path

import pytest


class _Seen:
    """Names of the tests that passed."""

    def __init__(self):
        self.passed = []

    def pytest_runtest_logreport(self, report):
        if report.when == "call" and report.passed:
            self.passed.append(report.nodeid)


def passed(*words):
    """What ``pytest WORDS`` passes, all of it; nothing of it stays imported."""
    seen, path = _Seen(), list(sys.path)
    try:
        code = pytest.main(
            ["-q", "-p", "no:cacheprovider", "-p", "no:faulthandler", *words], plugins=[seen]
        )
    finally:
        sys.path[:] = path
        for name, module in list(sys.modules.items()):
            if Path(getattr(module, "__file__", None) or "/").is_relative_to(Path.cwd()):
                del sys.modules[name]
    assert code == 0
    return seen.passed
