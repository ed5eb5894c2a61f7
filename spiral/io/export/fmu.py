"""A model as an FMU (FMI 2.0): the exported C with the interface around it, source and binary.

The standard is at https://fmi-standard.org; the description lists every state, input, reading and
parameter with its unit, parameters with their estimates as start values and their standard errors
in words.
"""

from __future__ import annotations

import io
import platform
import shutil
import subprocess
import tempfile
import uuid
import zipfile
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree as Xml

from spiral.io.export.c import c
from spiral.io.export.names import plain
from spiral.io.export.program import Item, Program, described
from spiral.io.writing import filled
from spiral.types.errors import ConfigError
from spiral.types.units import base_form, short_form

_COMPILERS = ("cc", "gcc", "clang")
_FLAGS = ("-std=c99", "-O2", "-shared", "-fPIC", "-fvisibility=hidden")
_TIME = (1980, 1, 1, 0, 0, 0)  # of every file in the archive: the same model, the same bytes
_OWN_STEP = "integration_step"


def fmu(found: Program) -> bytes:
    """The archive.

    Raises
    ------
    ConfigError : no C compiler here, or one that fails.
    """
    source = c(found)
    guid = "{" + str(uuid.uuid5(uuid.NAMESPACE_OID, source)) + "}"
    interface = filled("export_fmi2", name=found.name, guid=guid)
    texts = {f"{found.name}.c": source, "fmi2.c": interface}
    files: dict[str, str | bytes] = {
        "modelDescription.xml": _description(found, guid),
        "documentation/index.html": _page(found),
        **{f"sources/{name}": text for name, text in texts.items()},
    }
    folder, suffix = _platform()
    files[f"binaries/{folder}/{found.name}{suffix}"] = _binary(texts)
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as out:
        for name, content in files.items():
            out.writestr(zipfile.ZipInfo(name, _TIME), content, zipfile.ZIP_DEFLATED)
    return archive.getvalue()


def _platform() -> tuple[str, str]:
    """The folder of this machine's binaries, and their suffix."""
    system, machine = platform.system(), platform.machine().lower()
    name, suffix = {"Windows": ("win", ".dll"), "Darwin": ("darwin", ".dylib")}.get(
        system, ("linux", ".so")
    )
    if machine in ("x86_64", "amd64"):
        return f"{name}64", suffix
    return f"{'aarch64' if machine == 'arm64' else machine}-{system.lower()}", suffix


def _binary(texts: dict[str, str]) -> bytes:
    """The sources as a shared library of this machine."""
    compiler = next(filter(None, map(shutil.which, _COMPILERS)), None)
    if compiler is None:
        raise ConfigError(
            "export to fmu on a machine without a C compiler",
            f"one of {', '.join(_COMPILERS)} on the path",
            "install one (gcc, for instance), or --to c",
        )
    with tempfile.TemporaryDirectory() as place:
        for name, text in texts.items():
            Path(place, name).write_text(text, encoding="utf-8")
        command = [compiler, *_FLAGS, "-o", "model", "fmi2.c", "-lm"]
        done = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise ConfigError(
                f"{compiler}: {plain(done.stderr) or done.returncode}", "a C99 compiler", "--to c"
            )
        return Path(place, "model").read_bytes()


def _description(found: Program, guid: str) -> str:
    """modelDescription.xml; the order of variables is that of value references in fmi2.c."""
    root = Xml.Element(
        "fmiModelDescription", fmiVersion="2.0", modelName=plain(found.title), guid=guid,
        description=plain(f"{found.title}, {found.origin}" if found.origin else found.title),
        generationTool=plain(described(found)[0].rpartition("(")[2].rstrip(")")),
        variableNamingConvention="flat", numberOfEventIndicators="0",
    )  # fmt: skip
    can = {"modelIdentifier": found.name, "canGetAndSetFMUstate": "true",
           "canSerializeFMUstate": "true", "providesDirectionalDerivative": "true",
           "canNotUseMemoryManagementFunctions": "true"}  # fmt: skip
    _sources(Xml.SubElement(root, "ModelExchange", can))
    together = {"canHandleVariableCommunicationStepSize": "true", "canInterpolateInputs": "true"}
    _sources(Xml.SubElement(root, "CoSimulation", can | together))
    _units(root, found)
    _variables(root, found)
    _structure(root, found)
    Xml.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + Xml.tostring(root, encoding="unicode")


def _sources(parent: Xml.Element) -> None:
    Xml.SubElement(Xml.SubElement(parent, "SourceFiles"), "File", name="fmi2.c")


def _units(root: Xml.Element, found: Program) -> None:
    """Units with their base units; those with broken exponents by name alone."""
    items = (*found.states, *found.inputs, *found.outputs, *found.parameters)
    rates = [_rate_unit(s) for s in found.states]
    place = Xml.SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys(filter(None, ("s", *(i.unit for i in items), *rates))):
        factor, exponents = base_form(unit)
        written = Xml.SubElement(place, "Unit", name=plain(unit))
        if all(e.is_integer() for e in exponents.values()):
            base = {k: str(int(e)) for k, e in exponents.items()}
            Xml.SubElement(written, "BaseUnit", base | {"factor": repr(factor)})


def _rate_unit(state: Item) -> str:
    return short_form(f"({state.unit})/s") if state.unit else "1/s"


def _variables(root: Xml.Element, found: Program) -> None:
    place = Xml.SubElement(root, "ModelVariables")
    taken: set[str] = set()

    def add(item: tuple[str, str, str], start: float | None, **how: str) -> None:
        name, unit, about = item
        name = plain(name) or "value"
        while name in taken:
            name += "_"
        about = {"name": name, "valueReference": str(len(taken)), "description": plain(about)}
        taken.add(name)
        kind = {"unit": plain(unit)} if unit else {}
        kind |= {} if start is None else {"start": repr(start)}
        derivative = {"derivative": how.pop("derivative")} if "derivative" in how else {}
        variable = Xml.SubElement(place, "ScalarVariable", about | how)
        Xml.SubElement(variable, "Real", kind | derivative)

    for s in found.states:
        add((s.name, s.unit, s.about), 0.0, causality="local", initial="exact")
    for number, s in enumerate(found.states, 1):
        add((f"der({s.name})", _rate_unit(s), f"rate of {s.name}"), None, causality="local",
            derivative=str(number))  # fmt: skip
    for i in found.inputs:
        add((i.name, i.unit, i.about), 0.0, causality="input")
    for o in found.outputs:
        add((f"reading_{o.name}", o.unit, f"reading of {o.name}"), None, causality="output")
    for p in found.parameters:
        add((p.name, p.unit, p.about), p.value, causality="parameter", variability="tunable")
    words = "longest step of co-simulation; 0: one for each communication step"
    add((_OWN_STEP, "s", words), 0.0, causality="parameter", variability="tunable")


def _structure(root: Xml.Element, found: Program) -> None:
    """Which variables are outputs and derivatives; numbers count variables from 1."""
    n, inputs = len(found.states), len(found.inputs)
    place = Xml.SubElement(root, "ModelStructure")
    derivatives, outputs = (
        range(n + 1, 2 * n + 1),
        range(2 * n + inputs + 1, 2 * n + inputs + len(found.outputs) + 1),
    )
    for name, numbers in (("Outputs", outputs), ("Derivatives", derivatives)):
        _unknowns(Xml.SubElement(place, name), numbers)
    _unknowns(Xml.SubElement(place, "InitialUnknowns"), sorted((*outputs, *derivatives)))


def _unknowns(place: Xml.Element, numbers: Iterable[int]) -> None:
    for number in numbers:
        Xml.SubElement(place, "Unknown", index=str(number))


def _page(found: Program) -> str:
    """The head of the C file as a page."""
    page = Xml.Element("html")
    Xml.SubElement(Xml.SubElement(page, "head"), "title").text = plain(found.title)
    Xml.SubElement(Xml.SubElement(page, "body"), "pre").text = "\n".join(described(found))
    return "<!DOCTYPE html>\n" + Xml.tostring(page, encoding="unicode", method="html")
