"""Traced physics to machine code.

    rate(x, u, p, f, A, B)      f = x', A = f_x, B = f_p        rate_value(x, u, p, f)
    output(x, u, p, y, C, D)    y = h,  C = h_x, D = h_p        output_value(x, u, p, y)

LLVM, through the library that Numba brings, is given the expressions with their exact derivatives
(``emit``), and Numba's loops are given the addresses. Machine code is kept for other processes
(``object_code``).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence, Set
from dataclasses import dataclass
from functools import cache
from typing import Any

import numba as nb
import numpy as np
import sympy as sp
from llvmlite import __version__ as llvmlite_version
from llvmlite import binding, ir
from numba import types
from numba.core.registry import cpu_target
from numba.extending import typeof_impl

from spiral.physics.emit import INDEX, Emitter
from spiral.physics.object_code import kept_code
from spiral.physics.trace import TracedModel
from spiral.types.cache import kept

_VECTOR, _MATRIX = types.float64[::1], types.float64[:, ::1]
_USUAL = 2  # level of optimisation
_LONG = 50_000  # lines of intermediate code, beyond which none of it pays
MODEL_FUNCTION = types.FunctionType(
    types.void(_VECTOR, _VECTOR, _VECTOR, _VECTOR, _MATRIX, _MATRIX)
)
VALUE_FUNCTION = types.FunctionType(types.void(_VECTOR, _VECTOR, _VECTOR, _VECTOR))


@dataclass(frozen=True)
class CompiledModel:
    """The compiled functions of one traced model."""

    traced: TracedModel
    rate: Any
    output: Any
    rate_value: Any
    output_value: Any


class ModelFunction(types.WrapperAddressProtocol):
    """Machine code of one equation, for Numba's loops and for a call from Python."""

    def __init__(self, kind: types.FunctionType, engine: Any, name: str) -> None:
        self.kind, self._engine = kind, engine  # the code lives as long as its engine
        self._address = engine[name]

    def __wrapper_address__(self) -> int:
        return self._address

    def signature(self) -> Any:
        """The function's type as a signature of Numba."""
        return self.kind.signature

    def __call__(self, *arrays: Any) -> None:
        """Evaluated at contiguous arrays; the last ones are written."""
        caller = _call_with_slopes if self.kind is MODEL_FUNCTION else _call_value
        caller(self, *arrays)

    def parameter_slopes(self, x: Any, u: Any, p: Any, columns: Sequence[int]) -> Any:
        """B = f_p at every row of x and u, these columns alone: (rows, equations, columns).

        ``p`` is one value of every parameter; ``f`` has as many equations as ``x`` has columns.
        """
        wanted = np.array(columns, dtype=np.int64)
        x, u, p = (np.ascontiguousarray(values, dtype=float) for values in (x, u, p))
        slopes = np.zeros((*x.shape, len(wanted)))
        _slopes_along_rows(self, x, u, p, wanted, slopes)
        return slopes


@typeof_impl.register(ModelFunction)
def _function_type(function, _):
    """Numba's type of a model function, always the same object: a new one would be compared."""
    return function.kind


@nb.njit(
    types.void(MODEL_FUNCTION, _VECTOR, _VECTOR, _VECTOR, _VECTOR, _MATRIX, _MATRIX), cache=True
)
def _call_with_slopes(function, x, u, p, f, a, b):
    function(x, u, p, f, a, b)


@nb.njit(
    types.void(
        MODEL_FUNCTION, _MATRIX, _MATRIX, _VECTOR, types.int64[::1], types.float64[:, :, ::1]
    ),
    cache=True,
)
def _slopes_along_rows(function, x, u, p, columns, slopes):
    rows, n = x.shape
    f, a, b = np.empty(n), np.zeros((n, n)), np.zeros((n, len(p)))
    for row in range(rows):
        function(x[row], u[row], p, f, a, b)
        for k in range(len(columns)):
            slopes[row, :, k] = b[:, columns[k]]


@nb.njit(types.void(VALUE_FUNCTION, _VECTOR, _VECTOR, _VECTOR, _VECTOR), cache=True)
def _call_value(function, x, u, p, f):
    function(x, u, p, f)


@kept(128)
def compile_model(traced: TracedModel, by: tuple[str, ...] | None = None) -> CompiledModel:
    """The model's functions; those of the last models are kept for this process.

    ``by`` names the parameters that derivatives are wanted for; all where left out. The columns of
    the others in B and D are not written: faster for a filter that tracks few parameters.

    Raises
    ------
    PluginError : a function that has no machine code.
    """
    wanted = traced.keys if by is None else by
    module = ir.Module("model")
    for name, values in (("rate", traced.rate), ("output", traced.output)):
        write_function(
            module, name, traced, values, [j for j, k in enumerate(traced.keys) if k in wanted]
        )
        write_function(module, f"{name}_value", traced, values, None)
    engine = engine_of(module)
    return CompiledModel(
        traced,
        *(ModelFunction(MODEL_FUNCTION, engine, name) for name in ("rate", "output")),
        *(ModelFunction(VALUE_FUNCTION, engine, f"{name}_value") for name in ("rate", "output")),
    )


def begin_function(
    module: ir.Module, name: str, kind: types.FunctionType
) -> tuple[ir.IRBuilder, Sequence[Any]]:
    """A new function of the module as Numba calls it: the builder of its body, its arguments."""
    context: Any = cpu_target.target_context
    function = ir.Function(module, context.get_value_type(kind.ftype).pointee, name)
    return ir.IRBuilder(function.append_basic_block()), function.args


def end_function(builder: ir.IRBuilder) -> None:
    """Write the return of a function, which gives Numba no value."""
    builder.ret(ir.Constant(builder.function.ftype.return_type, None))


def load_symbols(
    builder: ir.IRBuilder, data: Any, symbols: Sequence[sp.Symbol], used: Set[sp.Basic]
) -> dict[sp.Symbol, Any]:
    """Load those symbols of an array that are used: symbol -> value."""
    return {
        symbol: builder.load(element_address(builder, data, place))
        for place, symbol in enumerate(symbols)
        if symbol in used
    }


def element_address(builder: ir.IRBuilder, data: Any, place: int) -> Any:
    """The address of an entry of an array."""
    return builder.gep(data, [ir.Constant(INDEX, place)])


def write_function(
    module: ir.Module,
    name: str,
    traced: TracedModel,
    values: Sequence[sp.Expr],
    columns: Sequence[int] | None,
    by_states: bool = True,
) -> None:
    """A function of the module; with Jacobians by all states and these parameters, or without.

    ``by_states`` : whether the slopes by states are written where ``columns`` are given.
    """
    builder, args = begin_function(
        module, name, VALUE_FUNCTION if columns is None else MODEL_FUNCTION
    )
    data = [builder.extract_value(a, 4) for a in args]
    used = set().union(*(e.free_symbols for e in values))
    groups = (traced.x, traced.u, traced.p)
    given: dict[sp.Symbol, Any] = {}
    for array, group in zip(data[:3], groups, strict=True):
        given |= load_symbols(builder, array, group, used)
    n = len(traced.x)
    active: dict[sp.Symbol, int] = {}
    if columns is not None:
        active = {s: i for i, s in enumerate(traced.x) if by_states}
        active |= {traced.p[j]: n + j for j in columns}
    emitter = Emitter(builder, given, active)
    for i, expression in enumerate(values):
        node = emitter.node(expression)
        builder.store(node.value, element_address(builder, data[3], i))
        for key, slope in node.slopes.items():
            array, column = (4, key) if key < n else (5, key - n)
            builder.store(slope, _entry_address(builder, args[array], i, column))
    end_function(builder)


def _entry_address(builder: ir.IRBuilder, matrix: Any, row: int, column: int) -> Any:
    """The address of an entry of a matrix, which may have more columns than the model needs."""
    width = builder.extract_value(matrix, [5, 1])
    place = builder.add(builder.mul(width, ir.Constant(INDEX, row)), ir.Constant(INDEX, column))
    return builder.gep(builder.extract_value(matrix, 4), [place])


@cache
def _target_machine(level: int) -> Any:
    """The processor to compile for, at a level of optimisation."""
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding.Target.from_default_triple().create_target_machine(
        cpu=binding.get_host_cpu_name(),
        features=binding.get_host_cpu_features().flatten(),
        opt=level,
        jit=True,
    )


@cache
def _linker() -> Any:
    """The linker of the machine code: one for the process.

    An engine for each model would hold the model's intermediate form and a machine of its own, five
    times the memory of the code.
    """
    return binding.create_lljit_compiler(_target_machine(_USUAL))


_numbers = itertools.count()  # libraries of code: no name is used twice


def engine_of(module: ir.Module) -> Any:
    """The module's machine code: addresses of its functions by name, valid while this is kept.

    Registers are shared out in a time that grows faster than the code, so that a model with
    hundreds of candidates in it, which is run a few times, takes longer to compile than to run: it
    is compiled plainly.
    """
    linker, text = _linker(), str(module)
    level = _USUAL if text.count("\n") <= _LONG else 0
    code = kept_code(text, (*_translator(), str(level)), lambda: _translate(text, level))
    library = binding.JITLibraryBuilder().add_object_img(code).add_current_process()
    for function in module.functions:
        if not function.is_declaration:
            library.export_symbol(function.name)
    return library.link(linker, f"spiral{next(_numbers)}")


def _translator() -> tuple[str, ...]:
    """What machine code depends on beside the intermediate code: the compiler and the processor."""
    version = ".".join(map(str, binding.llvm_version_info))
    processor = (binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten())
    return llvmlite_version, version, binding.get_default_triple(), *processor


def _translate(text: str, level: int) -> bytes:
    """Machine code of a module, at a level of optimisation."""
    machine, parsed = _target_machine(level), binding.parse_assembly(text, binding.create_context())
    options = binding.create_pipeline_tuning_options(speed_level=max(level, 1))
    passes = binding.create_pass_builder(machine, options)
    passes.getModulePassManager().run(parsed, passes)
    return machine.emit_object(parsed)
