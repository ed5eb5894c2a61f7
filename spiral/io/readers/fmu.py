"""An FMU (model exchange, FMI 2.0 or 3.0) as a program: its description, its binary opened.

An FMU is a program of this machine. Only ``open_fmu`` runs it.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import re
import shutil
import weakref
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spiral.engine.threads import THREADS
from spiral.physics.outside import fmi
from spiral.physics.outside.program import CalledProgram
from spiral.types.cache import kept
from spiral.types.errors import ConfigError, InputError, similar_files
from spiral.types.identifier import identifier

INSTANCES = THREADS + 2  # threads that share a step, and one that asks beside them
_DIRECTIONAL = re.compile(rb'providesDirectionalDerivatives?\s*=\s*["\'](true|1)')  # both versions
_CLOSE = 1e-4  # of a directional derivative to a difference, relative to the largest of a column


@dataclass(frozen=True)
class Variable:
    """A scalar variable: ``name`` as an identifier, ``told`` as the FMU has it."""

    name: str
    told: str
    reference: int
    unit: str
    start: float
    nominal: float
    lower: float | None
    upper: float | None


@dataclass(frozen=True)
class Description:
    """What the modelDescription.xml of an FMU says; ``rates`` are references of the derivatives."""

    path: str
    title: str
    version: int
    identifier: str
    token: str
    once: bool
    events: bool
    directional: bool
    states: tuple[Variable, ...]
    rates: tuple[int, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    parameters: tuple[Variable, ...]


def file_sha256(path: str) -> str:
    """SHA-256 of a file.

    Raises
    ------
    InputError : a file that cannot be read.
    """
    try:
        return hashlib.sha256(Path(path).expanduser().read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(
            f"FMU {path!r}: {error.strerror}", "a file that can be read",
            similar_files(Path(path).expanduser()) or "check the path",
        ) from error  # fmt: skip


@kept(16)
def read_description(path: str, sha256: str) -> Description:
    """The description of an FMU; nothing of it is run.

    Raises
    ------
    InputError : no FMU, or one that cannot be used here, with the reason.
    """
    fmpy = _import_fmpy()
    place = str(Path(path).expanduser())
    try:
        model = fmpy.read_model_description(place, validate=False)
        with zipfile.ZipFile(place) as archive:
            names, written = archive.namelist(), archive.read("modelDescription.xml")
    except Exception as error:  # of a broken archive, XML, or a schema: each of a kind of its own
        said = " ".join(str(error).split())[:300] or type(error).__name__
        raise InputError(
            f"FMU {path!r}: {said}", "an FMU: a zip archive with a modelDescription.xml",
            "export it anew; python -m fmpy validate FILE tells more",
        ) from error  # fmt: skip
    _check_interface(path, model)
    _check_binary(path, model, names, fmpy)
    return _convert_description(path, model, bool(_DIRECTIONAL.search(written)))


def _import_fmpy() -> Any:
    try:
        import fmpy
    except ImportError as error:
        raise ConfigError(
            "system=fmu without FMPy", "the extra exports", "pip install 'spiral[exports]'"
        ) from error
    return fmpy


def _check_interface(path: str, model: Any) -> None:
    """Refuse versions and kinds that have no rates to ask for."""
    if model.fmiVersion.split(".")[0] not in ("2", "3"):
        raise InputError(f"FMU {path!r} of FMI {model.fmiVersion}", "FMI 2.0 or 3.0")
    if model.modelExchange is None:
        raise InputError(
            f"FMU {path!r} for co-simulation alone",
            "model exchange: effects act on rates, and a step of co-simulation hides them",
            "export it once more with model exchange (in most tools a choice of the export)",
        )
    if not model.numberOfContinuousStates:
        raise InputError(f"FMU {path!r} without continuous states", "at least one state")


def _check_binary(path: str, model: Any, names: Sequence[str], fmpy: Any) -> None:
    """Refuse an FMU without a binary for this machine."""
    here = fmpy.platform_tuple if model.fmiVersion.startswith("3") else fmpy.platform
    folders = {n.split("/")[1] for n in names if n.startswith("binaries/") and n.count("/") > 1}
    if here not in folders:
        raise InputError(
            f"FMU {path!r} with binaries for {', '.join(sorted(folders)) or 'no machine'}",
            f"one for {here}",
            "export it for this machine; where it holds its source: python -m fmpy compile FILE",
        )


def _convert_description(path: str, model: Any, directional: bool) -> Description:
    names: dict[str, str] = {}
    units = {u.name: u for u in model.unitDefinitions}
    rows = [d.variable for d in model.derivatives if d.variable.derivative is not None]
    scalar = [v for v in model.modelVariables if _is_real_scalar(v)]

    def convert(variables: Iterable[Any]) -> tuple[Variable, ...]:
        return tuple(_convert_variable(v, names, units) for v in variables)

    def with_causality(causality: str) -> list[Any]:
        return [v for v in scalar if v.causality == causality]

    way = model.modelExchange
    return Description(
        path=path,
        title=model.modelName or "",
        version=int(model.fmiVersion.split(".")[0]),
        identifier=way.modelIdentifier,
        token=model.instantiationToken,
        once=bool(way.canBeInstantiatedOnlyOncePerProcess),
        events=bool(int(model.numberOfEventIndicators or 0)),
        directional=directional,
        states=convert(v.derivative for v in rows),
        rates=tuple(v.valueReference for v in rows),
        inputs=convert(with_causality("input")),
        outputs=convert(with_causality("output")),
        parameters=convert(v for v in with_causality("parameter") if v.variability == "tunable"),
    )  # fmt: skip


def _is_real_scalar(variable: Any) -> bool:
    return variable.type in ("Real", "Float64") and not variable.dimensions


def _convert_variable(scalar: Any, names: dict[str, str], units: Mapping[str, Any]) -> Variable:
    name = names.get(scalar.name) or identifier(scalar.name, set(names.values()))
    names[scalar.name] = name
    own = scalar.declaredType
    unit = scalar.unit or (own.unit if own is not None else "") or ""
    return Variable(
        name, scalar.name, scalar.valueReference, _known_unit(unit, units),
        _finite_number(scalar.start) or 0.0, abs(_finite_number(scalar.nominal) or 0.0) or 1.0,
        _finite_number(scalar.min), _finite_number(scalar.max),
    )  # fmt: skip


def _finite_number(given: Any) -> float | None:
    try:
        number = float(given)
    except (TypeError, ValueError):
        return None
    return number if np.isfinite(number) else None


def _known_unit(told: str, units: Mapping[str, Any]) -> str:
    """A unit as it is written here; ``N.m/rad``, ``kg.m2`` and base units are understood.

    An unknown unit is returned as empty.
    """
    from spiral.types.units import short_form

    text = re.sub(r"(?<=[A-Za-z])(-?\d+)", r"^\1", told.replace(".", "*"))
    base = units[told].baseUnit if told in units else None
    powers = {} if base is None or base.factor not in (None, 1, 1.0) else {
        name: getattr(base, name) for name in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
    }  # fmt: skip
    written = "*".join(f"{n}^{p}" for n, p in powers.items() if p)
    for way in (told, text, written):
        try:
            short_form(way)
        except Exception:  # (pint's parser raises what Python's tokenizer does)
            continue
        return "" if way == "1" else way
    return ""


# --- opened --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class OpenFmu:
    """An FMU with instances in continuous-time mode.

    ``start`` are the arguments at the beginning; ``readings`` tell the output (as the FMU names it)
    that a state is measured by, by name.
    """

    program: CalledProgram
    start: tuple[float, ...]
    readings: tuple[tuple[str, str], ...]


@kept(8)
def open_fmu(path: str, sha256: str) -> OpenFmu:
    """Run an FMU: its binary is loaded, its instances are made and set.

    Raises
    ------
    InputError : an FMU that does not start, with its own words.
    """
    about = read_description(path, sha256)
    try:
        models, folder = _make_instances(about)
        handles = [m.component if isinstance(m.component, int) else m.component.value
                   for m in models]  # fmt: skip
        start = _start_arguments(about, models[0], handles[0])
    except InputError:
        raise
    except Exception as error:  # of a loader, of FMPy's wrapper: each of a kind of its own
        said = " ".join(str(error).split())[:300] or type(error).__name__
        raise InputError(
            f"FMU {path!r} does not start: {said}", "an FMU that FMPy can run",
            "python -m fmpy simulate FILE; the libraries that it needs may be missing",
        ) from error  # fmt: skip
    program = _make_called_program(about, models, handles, folder)
    _choose_slopes(about, program, start)
    return OpenFmu(program, start, _state_outputs(about, models[0], program, start))


def _make_instances(about: Description) -> tuple[list[Any], str]:
    from fmpy import extract
    from fmpy.fmi2 import FMU2Model
    from fmpy.fmi3 import FMU3Model

    here, folder = Path.cwd(), str(extract(str(Path(about.path).expanduser())))
    kind = FMU3Model if about.version == 3 else FMU2Model
    models = []
    try:
        for number in range(1 if about.once else INSTANCES):
            model = kind(
                guid=about.token, modelIdentifier=about.identifier, unzipDirectory=folder,
                instanceName=f"spiral_{number}",
            )  # fmt: skip
            model.instantiate()
            _initialise_instance(model, about.version)
            models.append(model)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    finally:
        os.chdir(here)  # FMPy loads from the library's folder, and stays there where that fails
    return models, folder


def _initialise_instance(model: Any, version: int) -> None:
    """From instantiation to continuous-time mode, at time zero."""
    if version == 3:
        model.enterInitializationMode(startTime=0.0)
    else:
        model.setupExperiment(startTime=0.0)
        model.enterInitializationMode()
    model.exitInitializationMode()
    for _ in range(10):
        told = model.updateDiscreteStates() if version == 3 else model.newDiscreteStates()
        if not told[0]:
            break
    model.enterContinuousTimeMode()


def _function_address(model: Any, name: str) -> int:
    try:
        return int(ctypes.cast(getattr(model.dll, name), ctypes.c_void_p).value or 0)
    except AttributeError:
        if "Directional" in name:
            return 0
        raise


def _start_arguments(about: Description, model: Any, handle: int) -> tuple[float, ...]:
    """States as they begin, inputs and parameters as they are described, time zero."""
    count = len(about.states)
    x = np.zeros(count)
    given = x.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
    if about.version == 3:
        model.getContinuousStates(given, count)
    else:
        model.fmi2GetContinuousStates(model.component, given, count)
    beside = (v.start for v in (*about.inputs, *about.parameters))
    return (*x.tolist(), *beside, 0.0)


def _make_called_program(
    about: Description, models: Sequence[Any], handles: Sequence[int], folder: str
) -> CalledProgram:
    groups = (about.states, about.inputs, about.parameters)
    names = ("states", "inputs", "parameters")
    references = {n: [v.reference for v in g] for n, g in zip(names, groups, strict=True)}
    whole, numbers = fmi.kernel_memory(
        about.version,
        [_function_address(models[0], n) for n in fmi.FUNCTIONS[about.version]],
        handles,
        {**references, "rates": about.rates},
        [v.nominal for g in groups for v in g],
        about.events,
    )
    arguments = (*(v.name for g in groups for v in g), "time")
    rows = tuple(v.name for v in about.states)
    made = CalledProgram(
        Path(about.path).name, rows, arguments, fmi.kernel.address, whole, numbers, models
    )
    weakref.finalize(made, shutil.rmtree, folder, ignore_errors=True)
    return made


def _choose_slopes(about: Description, program: CalledProgram, start: Sequence[float]) -> None:
    """Use the FMU's directional derivatives by arguments where they agree with differences."""
    count = len(program.arguments) - 1
    if not about.directional or not program.whole[fmi.Slot.DIRECTION]:
        return
    rng = np.random.default_rng(1)
    points = np.asarray(start) + 0.01 * rng.normal(size=(3, count + 1)) * (1 + np.abs(start))
    columns = range(count)
    _, due = program.values_and_slopes(points, columns)
    right = []
    for column in columns:  # one by one: an FMU may refuse one argument
        fmi.set_slope_kinds(program.whole, [fmi.DIRECTIONAL] * count)
        _, told = program.values_and_slopes(points, (column,))
        size = np.abs(due[:, column]).max() + np.abs(due).max() * 1e-12
        right.append(bool((np.abs(told[:, 0] - due[:, column]) <= _CLOSE * size).all()))
    kinds = [fmi.DIRECTIONAL if r else fmi.DIFFERENCE for r in right]
    fmi.set_slope_kinds(program.whole, kinds)


def _state_outputs(
    about: Description, model: Any, program: CalledProgram, start: Sequence[float]
) -> tuple[tuple[str, str], ...]:
    """Pairs (output, state) whose values are equal at several random points."""
    rng = np.random.default_rng(2)
    points = np.asarray(start) + 0.01 * rng.normal(size=(3, len(start))) * (1 + np.abs(start))
    told = []
    for point in points:
        program.values_and_slopes(point)  # by the first instance, which is free
        references = [v.reference for v in about.outputs]
        get = model.getFloat64 if about.version == 3 else model.getReal
        told.append(list(get(references)) if references else [])
    matches = []
    for i, output in enumerate(about.outputs):
        values = np.array([row[i] for row in told])
        for j, state in enumerate(about.states):
            if np.allclose(values, points[:, j], rtol=1e-12, atol=0.0):
                matches.append((output.told, state.name))
                break
    return tuple(matches)
