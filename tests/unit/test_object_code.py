"""Machine code of models that is kept on disk."""

import os

import numpy as np
import pytest
from llvmlite import ir

from spiral.physics import object_code
from spiral.physics.compile import engine_of
from spiral.types import kernel_cache


@pytest.fixture(name="folder")
def _folder(tmp_path, monkeypatch):
    """The folder of models in a cache of the test's own."""
    monkeypatch.setenv(kernel_cache.VARIABLE, str(tmp_path))
    object_code._folder.cache_clear()
    yield tmp_path / "models"
    object_code._folder.cache_clear()


def _code_of(text, settings=("cpu",), code=b"machine code"):
    """The kept code, and whether it was translated."""
    asked = []
    result = object_code.kept_code(text, settings, lambda: asked.append(1) or code)
    return result, bool(asked)


def test_code_is_translated_once_for_each_text_and_processor(folder):
    assert _code_of("one") == (b"machine code", True)
    assert _code_of("one") == (b"machine code", False)
    assert _code_of("two") == (b"machine code", True)
    assert _code_of("one", ("another cpu",)) == (b"machine code", True)
    assert len(list(folder.iterdir())) == 3


@pytest.mark.parametrize("spoilt", [b"", b"short", b"x" * 100])
def test_a_file_that_is_not_what_was_written_is_translated_again(folder, spoilt):
    _code_of("one")
    (path,) = folder.iterdir()
    path.write_bytes(spoilt)
    assert _code_of("one") == (b"machine code", True)
    assert _code_of("one") == (b"machine code", False)


def test_code_that_another_user_could_have_written_is_not_loaded(folder):
    _code_of("one")
    folder.chmod(0o770)
    object_code._folder.cache_clear()
    assert _code_of("one") == (b"machine code", True)


def test_a_link_to_a_folder_is_not_taken_for_it(folder, tmp_path):
    other = tmp_path / "other"
    other.mkdir(mode=0o700)
    folder.symlink_to(other)
    assert _code_of("one") == (b"machine code", True)
    assert not list(other.iterdir())


def test_what_was_not_used_for_longest_goes_first(folder, monkeypatch):
    for place, text in enumerate(("old", "used", "new")):
        _code_of(text, code=bytes(100))
        newest = max(folder.iterdir(), key=lambda p: p.stat().st_mtime)
        os.utime(newest, (place, place))
    assert _code_of("used", code=bytes(100)) == (bytes(100), False)
    monkeypatch.setattr(object_code, "_MOST", 300)
    object_code._folder.cache_clear()
    kept = {text: not _code_of(text, code=bytes(100))[1] for text in ("used", "old", "new")}
    assert kept == {"old": False, "used": True, "new": False}


def _doubling_module():
    """A module with a function that doubles the number at an address."""
    module, number = ir.Module("test"), ir.DoubleType()
    function = ir.Function(module, ir.FunctionType(ir.VoidType(), [number.as_pointer()]), "double")
    builder = ir.IRBuilder(function.append_basic_block())
    address = function.args[0]
    builder.store(builder.fmul(builder.load(address), ir.Constant(number, 2.0)), address)
    builder.ret_void()
    return module


def test_code_from_disk_computes_what_code_just_made_does(folder, monkeypatch):
    import ctypes

    engines = [engine_of(_doubling_module())]
    monkeypatch.setattr("spiral.physics.compile._translate", lambda *_: pytest.fail("translated"))
    engines.append(engine_of(_doubling_module()))
    for engine in engines:
        value = np.array([21.0])
        ctypes.CFUNCTYPE(None, ctypes.c_void_p)(engine["double"])(value.ctypes.data)
        assert value[0] == 42.0
