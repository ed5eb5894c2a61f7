"""FMUs of the machines: by the exporter, or compiled from hand-written C."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import zipfile
from pathlib import Path
from xml.etree import ElementTree as Xml

import spiral
from experiments.fmu.kinds import Case, Kind
from spiral.inference.simulate import with_defaults
from spiral.types.model import seed_model
from spiral.types.system import System

SOURCES = Path(__file__).parent / "sources"


def native(kind: Kind, forced: bool = False) -> System:
    """The machine as equations; with an input for a force on each coordinate where asked."""
    entries = {c: kind.force_input(c) if forced else "0" for c in kind.coordinates}
    inputs = dict([kind.input])
    if forced:
        inputs |= {kind.force_input(c): unit for c, unit in kind.forces.items()}
    lines = [line.format(**entries).replace(" + 0", "") for line in kind.equations]
    text = {
        "equations": lines, "states": dict(kind.states), "inputs": inputs,
        "parameters": {k: f"{v!r} {unit}" for k, (v, unit) in kind.parameters.items()},
        "free": list(kind.free), "observed": list(kind.observed),
    }  # fmt: skip
    import yaml

    with tempfile.TemporaryDirectory() as place:
        file = Path(place, f"{kind.name}.yaml")
        file.write_text(yaml.safe_dump(text, sort_keys=False), encoding="utf-8")
        return spiral.system(file)


def fmu(case: Case, kind: Kind, folder: Path) -> Path:
    """The FMU of a case."""
    target = folder / f"{kind.name}_{case.way}.fmu"
    if case.way == "C":
        return _by_hand(kind, target)
    model = with_defaults(seed_model(native(kind, forced=True)))
    return spiral.export(model, "fmu" if case.way == "2" else "fmu3", target)


def system(case: Case, kind: Kind, file: Path) -> System:
    """The FMU as a user opens it."""
    named = {c: kind.force_input(c) for c in kind.coordinates}
    free = [name if case.way == "C" else f"system_{name}" for name in kind.free]
    return spiral.system(str(file), ports=named, observed=list(kind.observed), free=free)


def _by_hand(kind: Kind, target: Path) -> Path:
    """The C files compiled, with a description."""
    import fmpy

    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise SystemExit("no C compiler here")
    states, inputs = _states(kind), _inputs(kind)
    start = ", ".join(repr(v) for v, _ in kind.parameters.values())
    sizes = {"N": len(states), "NU": len(inputs), "NP": len(kind.parameters),
             "START": f"{{{start}}}", "MODEL": f'"{kind.name}.h"'}  # fmt: skip
    with tempfile.TemporaryDirectory() as place:
        library = Path(place, "model.so")
        options = ("-std=c99", "-O2", "-shared", "-fPIC", "-Wall", "-o", str(library))
        macros = [f"-D{k}={v}" for k, v in sizes.items()]
        source = str(SOURCES / "fmi2.c")
        subprocess.run([compiler, *options, *macros, source, "-lm"], check=True)
        with zipfile.ZipFile(target, "w") as archive:
            archive.writestr("modelDescription.xml", _description(kind, states, inputs))
            archive.write(library, f"binaries/{fmpy.platform}/{kind.name}.so")
    return target


def _states(kind: Kind) -> dict[str, str]:
    """States with units in the order of the C file: the equations' own, then speeds."""
    speeds = {f"v_{c}": f"{kind.states[c]}/s" for c in kind.coordinates}
    return {**kind.states, **speeds}


def _inputs(kind: Kind) -> dict[str, str]:
    return {kind.input[0]: kind.input[1],
            **{kind.force_input(c): unit for c, unit in kind.forces.items()}}  # fmt: skip


def _description(kind: Kind, states: dict[str, str], inputs: dict[str, str]) -> str:
    """modelDescription.xml; the measured states are outputs of the same value reference."""
    root = Xml.Element(
        "fmiModelDescription", fmiVersion="2.0", modelName=kind.name, guid="{by hand}",
        numberOfEventIndicators="0",
    )  # fmt: skip
    Xml.SubElement(root, "ModelExchange", modelIdentifier=kind.name)
    rows = [(n, {"causality": "local", "variability": "continuous", "initial": "exact"}, u, 0.0)
            for n, u in states.items()]  # fmt: skip
    rows += [(f"der({n})", {"causality": "local"}, "", None) for n in states]
    rows += [(n, {"causality": "input"}, u, 0.0) for n, u in inputs.items()]
    tunable = {"causality": "parameter", "variability": "tunable"}
    rows += [(n, tunable, u, v) for n, (v, u) in kind.parameters.items()]
    units = Xml.SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys(row[2] for row in rows if row[2]):
        Xml.SubElement(units, "Unit", name=unit)
    place = Xml.SubElement(root, "ModelVariables")
    for number, (name, how, unit, start) in enumerate(rows):
        real = {"unit": unit} if unit else {}
        real |= {} if start is None else {"start": repr(start)}
        if name.startswith("der("):
            real["derivative"] = str(number - len(states) + 1)
        _variable(place, name, number, how, real)
    for name in kind.observed:
        number = list(states).index(name)
        _variable(place, f"y_{name}", number, {"causality": "output"}, {"unit": states[name]})
    structure = Xml.SubElement(root, "ModelStructure")
    first = len(rows)
    numbers = {"Outputs": range(first, first + len(kind.observed)),
               "Derivatives": range(len(states), 2 * len(states))}  # fmt: skip
    for group, members in numbers.items():
        entry = Xml.SubElement(structure, group)
        for number in members:
            Xml.SubElement(entry, "Unknown", index=str(number + 1))
    return Xml.tostring(root, encoding="unicode")


def _variable(
    place: Xml.Element, name: str, number: int, how: dict[str, str], real: dict[str, str]
) -> None:
    entry = Xml.SubElement(place, "ScalarVariable", name=name, valueReference=str(number), **how)
    Xml.SubElement(entry, "Real", real)
