"""modelDescription.xml of an FMU: variables with units, estimates and standard errors.

The order of variables is that of value references in the C file (``export_fmi.template``).
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree as Xml

from spiral.io.export.names import sanitise_text
from spiral.io.export.program import Program, ProgramVariable, header_lines
from spiral.types.units import base_form, short_form


@dataclass(frozen=True)
class _Variable:
    """One row: ``derivative`` is the number (from 0) of the state that it is the rate of."""

    name: str
    unit: str
    about: str
    how: dict[str, str]
    start: float | None = None
    derivative: int | None = None


def fmi2_description(program: Program, token: str) -> Xml.Element:
    """The root element of modelDescription.xml for FMI 2.0."""
    root = Xml.Element(
        "fmiModelDescription", _root_attributes(program) | {"fmiVersion": "2.0", "guid": token},
        numberOfEventIndicators="0",
    )  # fmt: skip
    can = {"modelIdentifier": program.name, "canGetAndSetFMUstate": "true",
           "canSerializeFMUstate": "true", "providesDirectionalDerivative": "true",
           "canNotUseMemoryManagementFunctions": "true"}  # fmt: skip
    together = {"canHandleVariableCommunicationStepSize": "true", "canInterpolateInputs": "true"}
    for way, abilities in (("ModelExchange", can), ("CoSimulation", can | together)):
        files = Xml.SubElement(Xml.SubElement(root, way, abilities), "SourceFiles")
        Xml.SubElement(files, "File", name="fmi2.c")
    _add_unit_definitions(root, program)
    place = Xml.SubElement(root, "ModelVariables")
    rows = _list_variables(program)
    for number, row in enumerate(rows):
        own = {"name": row.name, "valueReference": str(number), "description": row.about}
        real = _unit_and_start(row)
        if row.derivative is not None:
            real["derivative"] = str(row.derivative + 1)
        Xml.SubElement(Xml.SubElement(place, "ScalarVariable", own | row.how), "Real", real)
    outputs, rates = _output_and_rate_indices(rows)
    structure = Xml.SubElement(root, "ModelStructure")
    for name, numbers in (("Outputs", outputs), ("Derivatives", rates),
                          ("InitialUnknowns", sorted((*outputs, *rates)))):  # fmt: skip
        group = Xml.SubElement(structure, name)
        for number in numbers:
            Xml.SubElement(group, "Unknown", index=str(number + 1))
    return root


def fmi3_description(program: Program, token: str) -> Xml.Element:
    """The root element of modelDescription.xml for FMI 3.0."""
    own = {"fmiVersion": "3.0", "instantiationToken": token}
    root = Xml.Element("fmiModelDescription", _root_attributes(program) | own)
    can = {"modelIdentifier": program.name, "canGetAndSetFMUState": "true",
           "canSerializeFMUState": "true", "providesDirectionalDerivatives": "true",
           "providesAdjointDerivatives": "true"}  # fmt: skip
    Xml.SubElement(root, "ModelExchange", can)
    Xml.SubElement(root, "CoSimulation", can, canHandleVariableCommunicationStepSize="true")
    _add_unit_definitions(root, program)
    place = Xml.SubElement(root, "ModelVariables")
    time = _Variable("time", "s", "", {"causality": "independent", "variability": "continuous"})
    rows = _list_variables(program, time)
    for number, row in enumerate(rows):
        own = {"name": row.name, "valueReference": str(number), "description": row.about}
        if row.derivative is not None:
            own["derivative"] = str(row.derivative)
        Xml.SubElement(place, "Float64", own | row.how | _unit_and_start(row))
    outputs, rates = _output_and_rate_indices(rows)
    structure = Xml.SubElement(root, "ModelStructure")
    for name, numbers in (("Output", outputs), ("ContinuousStateDerivative", rates),
                          ("InitialUnknown", sorted((*outputs, *rates)))):  # fmt: skip
        for number in numbers:
            Xml.SubElement(structure, name, valueReference=str(number))
    return root


def xml_text(root: Xml.Element) -> str:
    """An element as the text of an XML file."""
    Xml.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + Xml.tostring(root, encoding="unicode")


def documentation_page(program: Program) -> str:
    """The HTML documentation page: the header lines of the exported program."""
    root = Xml.Element("html")
    Xml.SubElement(Xml.SubElement(root, "head"), "title").text = sanitise_text(program.title)
    Xml.SubElement(Xml.SubElement(root, "body"), "pre").text = "\n".join(header_lines(program))
    return "<!DOCTYPE html>\n" + Xml.tostring(root, encoding="unicode", method="html")


def _root_attributes(program: Program) -> dict[str, str]:
    from spiral.version import __version__

    about = f"{program.title}, {program.origin}" if program.origin else program.title
    return {"modelName": sanitise_text(program.title), "description": sanitise_text(about),
            "generationTool": f"SPIRAL {__version__}",
            "variableNamingConvention": "flat"}  # fmt: skip


def _list_variables(program: Program, *more: _Variable) -> list[_Variable]:
    """All variables in order, their names different from one another."""
    state, given = {"causality": "local", "initial": "exact"}, {"causality": "input"}
    constant = {"causality": "parameter", "variability": "tunable"}
    state = state | {"variability": "continuous"}
    words = "longest step of co-simulation; 0: one for each communication step"
    rows = [
        *(_Variable(s.name, s.unit, s.about, state, 0.0) for s in program.states),
        *(_Variable(f"der({s.name})", _rate_unit(s), f"rate of {s.name}", {"causality": "local"},
                    derivative=i) for i, s in enumerate(program.states)),
        *(_Variable(i.name, i.unit, i.about, given, 0.0) for i in program.inputs),
        *(_Variable(f"reading_{o.name}", o.unit, f"reading of {o.name}", {"causality": "output"})
          for o in program.outputs),
        *(_Variable(p.name, p.unit, p.about, constant, p.value) for p in program.parameters),
        _Variable("integration_step", "s", words, constant, 0.0),
        *more,
    ]  # fmt: skip
    taken: set[str] = set()
    unique = []
    for row in rows:
        name = sanitise_text(row.name) or "value"
        while name in taken:
            name += "_"
        taken.add(name)
        unique.append(
            _Variable(name, row.unit, sanitise_text(row.about), row.how, row.start, row.derivative)
        )
    return unique


def _unit_and_start(row: _Variable) -> dict[str, str]:
    unit = {"unit": sanitise_text(row.unit)} if row.unit else {}
    return unit if row.start is None else unit | {"start": repr(row.start)}


def _output_and_rate_indices(rows: list[_Variable]) -> tuple[list[int], list[int]]:
    """Numbers (from 0) of outputs and of the states' rates."""
    outputs = [n for n, row in enumerate(rows) if row.how["causality"] == "output"]
    return outputs, [n for n, row in enumerate(rows) if row.derivative is not None]


def _add_unit_definitions(root: Xml.Element, program: Program) -> None:
    """Units with their base units; those that have no such form by name alone."""
    items = (*program.states, *program.inputs, *program.outputs, *program.parameters)
    rates = (_rate_unit(s) for s in program.states)
    place = Xml.SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys(filter(None, ("s", *(i.unit for i in items), *rates))):
        written, base = Xml.SubElement(place, "Unit", name=sanitise_text(unit)), base_form(unit)
        if base is not None:
            factor, powers = base
            powers = {name: str(power) for name, power in powers.items()}
            Xml.SubElement(written, "BaseUnit", powers | {"factor": repr(factor)})


def _rate_unit(state: ProgramVariable) -> str:
    return short_form(f"({state.unit})/s") if state.unit else "1/s"
