"""modelDescription.xml of an FMU: variables with units, estimates and standard errors.

The order of variables is that of value references in the C file (``export_fmi.template``).
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree as Xml

from spiral.io.export.names import plain
from spiral.io.export.program import Item, Program, described
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


def version_2(found: Program, token: str) -> Xml.Element:
    """The description as FMI 2.0 has it."""
    root = Xml.Element(
        "fmiModelDescription", _head(found) | {"fmiVersion": "2.0", "guid": token},
        numberOfEventIndicators="0",
    )  # fmt: skip
    can = {"modelIdentifier": found.name, "canGetAndSetFMUstate": "true",
           "canSerializeFMUstate": "true", "providesDirectionalDerivative": "true",
           "canNotUseMemoryManagementFunctions": "true"}  # fmt: skip
    together = {"canHandleVariableCommunicationStepSize": "true", "canInterpolateInputs": "true"}
    for way, abilities in (("ModelExchange", can), ("CoSimulation", can | together)):
        files = Xml.SubElement(Xml.SubElement(root, way, abilities), "SourceFiles")
        Xml.SubElement(files, "File", name="fmi2.c")
    _units(root, found)
    place = Xml.SubElement(root, "ModelVariables")
    rows = _variables(found)
    for number, row in enumerate(rows):
        own = {"name": row.name, "valueReference": str(number), "description": row.about}
        real = _quantity(row)
        if row.derivative is not None:
            real["derivative"] = str(row.derivative + 1)
        Xml.SubElement(Xml.SubElement(place, "ScalarVariable", own | row.how), "Real", real)
    outputs, rates = _unknowns(rows)
    structure = Xml.SubElement(root, "ModelStructure")
    for name, numbers in (("Outputs", outputs), ("Derivatives", rates),
                          ("InitialUnknowns", sorted((*outputs, *rates)))):  # fmt: skip
        group = Xml.SubElement(structure, name)
        for number in numbers:
            Xml.SubElement(group, "Unknown", index=str(number + 1))
    return root


def version_3(found: Program, token: str) -> Xml.Element:
    """The description as FMI 3.0 has it."""
    own = {"fmiVersion": "3.0", "instantiationToken": token}
    root = Xml.Element("fmiModelDescription", _head(found) | own)
    can = {"modelIdentifier": found.name, "canGetAndSetFMUState": "true",
           "canSerializeFMUState": "true", "providesDirectionalDerivatives": "true",
           "providesAdjointDerivatives": "true"}  # fmt: skip
    Xml.SubElement(root, "ModelExchange", can)
    Xml.SubElement(root, "CoSimulation", can, canHandleVariableCommunicationStepSize="true")
    _units(root, found)
    place = Xml.SubElement(root, "ModelVariables")
    time = _Variable("time", "s", "", {"causality": "independent", "variability": "continuous"})
    rows = _variables(found, time)
    for number, row in enumerate(rows):
        own = {"name": row.name, "valueReference": str(number), "description": row.about}
        if row.derivative is not None:
            own["derivative"] = str(row.derivative)
        Xml.SubElement(place, "Float64", own | row.how | _quantity(row))
    outputs, rates = _unknowns(rows)
    structure = Xml.SubElement(root, "ModelStructure")
    for name, numbers in (("Output", outputs), ("ContinuousStateDerivative", rates),
                          ("InitialUnknown", sorted((*outputs, *rates)))):  # fmt: skip
        for number in numbers:
            Xml.SubElement(structure, name, valueReference=str(number))
    return root


def text_of(root: Xml.Element) -> str:
    """An element as a file."""
    Xml.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + Xml.tostring(root, encoding="unicode")


def page(found: Program) -> str:
    """The head of the C file as the documentation's page."""
    root = Xml.Element("html")
    Xml.SubElement(Xml.SubElement(root, "head"), "title").text = plain(found.title)
    Xml.SubElement(Xml.SubElement(root, "body"), "pre").text = "\n".join(described(found))
    return "<!DOCTYPE html>\n" + Xml.tostring(root, encoding="unicode", method="html")


def _head(found: Program) -> dict[str, str]:
    from spiral.version import __version__

    about = f"{found.title}, {found.origin}" if found.origin else found.title
    return {"modelName": plain(found.title), "description": plain(about),
            "generationTool": f"SPIRAL {__version__}",
            "variableNamingConvention": "flat"}  # fmt: skip


def _variables(found: Program, *more: _Variable) -> list[_Variable]:
    """All variables in order, their names different from one another."""
    state, given = {"causality": "local", "initial": "exact"}, {"causality": "input"}
    constant = {"causality": "parameter", "variability": "tunable"}
    state = state | {"variability": "continuous"}
    words = "longest step of co-simulation; 0: one for each communication step"
    rows = [
        *(_Variable(s.name, s.unit, s.about, state, 0.0) for s in found.states),
        *(_Variable(f"der({s.name})", _rate_unit(s), f"rate of {s.name}", {"causality": "local"},
                    derivative=i) for i, s in enumerate(found.states)),
        *(_Variable(i.name, i.unit, i.about, given, 0.0) for i in found.inputs),
        *(_Variable(f"reading_{o.name}", o.unit, f"reading of {o.name}", {"causality": "output"})
          for o in found.outputs),
        *(_Variable(p.name, p.unit, p.about, constant, p.value) for p in found.parameters),
        _Variable("integration_step", "s", words, constant, 0.0),
        *more,
    ]  # fmt: skip
    taken: set[str] = set()
    unique = []
    for row in rows:
        name = plain(row.name) or "value"
        while name in taken:
            name += "_"
        taken.add(name)
        unique.append(
            _Variable(name, row.unit, plain(row.about), row.how, row.start, row.derivative)
        )
    return unique


def _quantity(row: _Variable) -> dict[str, str]:
    unit = {"unit": plain(row.unit)} if row.unit else {}
    return unit if row.start is None else unit | {"start": repr(row.start)}


def _unknowns(rows: list[_Variable]) -> tuple[list[int], list[int]]:
    """Numbers (from 0) of outputs and of the states' rates."""
    outputs = [n for n, row in enumerate(rows) if row.how["causality"] == "output"]
    return outputs, [n for n, row in enumerate(rows) if row.derivative is not None]


def _units(root: Xml.Element, found: Program) -> None:
    """Units with their base units; those that have no such form by name alone."""
    items = (*found.states, *found.inputs, *found.outputs, *found.parameters)
    rates = (_rate_unit(s) for s in found.states)
    place = Xml.SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys(filter(None, ("s", *(i.unit for i in items), *rates))):
        written, base = Xml.SubElement(place, "Unit", name=plain(unit)), base_form(unit)
        if base is not None:
            factor, powers = base
            powers = {name: str(power) for name, power in powers.items()}
            Xml.SubElement(written, "BaseUnit", powers | {"factor": repr(factor)})


def _rate_unit(state: Item) -> str:
    return short_form(f"({state.unit})/s") if state.unit else "1/s"
