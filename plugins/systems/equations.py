"""A system from equations as text, in a file or made from a Python function."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

from spiral.types.cache import kept
from spiral.types.errors import ConfigError
from spiral.types.parameter import State
from spiral.types.port import Port
from spiral.types.rates import per_second
from spiral.types.system import MechanicalSystem
from spiral.types.units import quantity

EXAMPLE = """\
title: A mass on a spring
equations: ["m*x'' + c*x' + k*x = F"]
states: {x: m}
inputs: {F: {unit: N, interpolation: band_limited}}
parameters: {m: 1.0 kg, c: 4.0 N*s/m, k: 4000 N/m}
free: [c, k]
observed: [x]
"""


class Equations(MechanicalSystem):
    """M q'' = f(q, q', z, u, p), z' = g(q, q', z, u, p) with formulas from a file.

    Fields
    ------
    path : a file in YAML, TOML or JSON (docs/how-to/own-model.md).
    text : what it holds, in YAML; with neither, a mass on a spring.
    """

    path: str = ""
    text: str = ""

    def __post_init__(self):
        """Read the file and its equations, so that what is wrong is said at once."""
        from spiral.physics.formulas.coherent import text_in_units_that_fit
        from spiral.physics.formulas.definition import check_free_parameters, text_of_file

        text = self.text or (text_of_file(self.path) if self.path else EXAMPLE)
        try:
            object.__setattr__(self, "text", text_in_units_that_fit(text))
            _ = self.ports
            if self.path:
                check_free_parameters(self.form.definition)
        except ConfigError as error:
            place = f"{self.path}: " if self.path else ""
            raise ConfigError(place + error.given, error.expected, error.try_) from error

    @property
    def form(self):
        """The equations in one form."""
        from spiral.physics.formulas.equations import equations_of

        return equations_of(self.text)

    @property
    def title(self):
        """That of the file."""
        return self.form.definition.title or self.plugin_name()

    @property
    def coordinates(self):
        """States that have an acceleration."""
        return self.form.coordinates

    @property
    def others(self):
        """States of first order."""
        return self.form.others

    @property
    def injections(self):
        """A force on each coordinate, a flow into each other state."""
        pairs = zip(self.coordinates, self.form.force_units, strict=True)
        flows = (State(s.name, per_second(s.unit)) for s in self.others)
        return (*(State(c.name, unit) for c, unit in pairs), *flows)

    @property
    def observed(self):
        """What is measured."""
        return self.form.definition.observed

    @property
    def readings(self):
        """Channels that are a formula."""
        return tuple(state for state, _ in self.form.readings)

    def reading(self, x, rates, u, p):
        """h(x, x', u, p) of each."""
        from spiral.physics.formulas.rows import FIRST, SECOND

        values = self._formula_values(*self.split(x), u, p)
        values |= {name + FIRST: rate for name, rate in vars(rates).items()}
        for c in self.coordinates:
            values[c.name + SECOND] = getattr(rates, self.rate_name(c.name))
        return {
            state.name: _compute_formulas([text], values)[0] for state, text in self.form.readings
        }

    @property
    def auxiliaries(self):
        """What ``let`` names, or a parameter multiplies, of two variables or more."""
        return tuple(state for state, _ in self.form.auxiliaries)

    @property
    def arguments(self):
        """Auxiliaries that a parameter multiplies: that parameter, and what it multiplies."""
        return {a.value.name: (a.parameter, a.words) for a in self.form.arguments}

    def auxiliary(self, x, u, p):
        """a(x, u, p) of each."""
        from spiral.physics.formulas.rows import FIRST

        if not self.form.auxiliaries:
            return {}
        q, v = self.split(x)
        values = self._formula_values(q, v, u, p)
        values |= {name + FIRST: rate for name, rate in vars(v).items()}
        names, texts = zip(*((a.name, text) for a, text in self.form.auxiliaries), strict=True)
        return dict(zip(names, _compute_formulas(texts, values), strict=True))

    @property
    def inputs(self):
        """Known inputs."""
        return self.form.definition.inputs

    @property
    def parameters(self):
        """Those with a value are known; the others, and those named free, are to be found."""
        return self.form.definition.parameters

    @property
    def defaults(self):
        """First values of parameters that are to be found."""
        return {f"system.{name}": value for name, value in self.form.definition.values}

    @property
    def written(self):
        """Name -> what the file says of it, its value and unit, where it is in SI here."""
        return dict(self.form.definition.converted)

    @property
    def written_units(self):
        """Name -> unit that the file has, and its size in the one here, where they differ."""
        from spiral.physics.formulas.definition import value_and_unit
        from spiral.physics.formulas.rows import size_of

        units, written = self.form.units, {}
        for name, words in self.written.items():
            unit = value_and_unit(name, words)[1]
            written[name] = (unit, size_of(unit) / size_of(units[name]))
        return written

    @property
    def ports(self):
        """Those named, each other coordinate, between any two, at each element; else each state."""
        return _equation_ports(self)

    @property
    def seed(self):
        """The equations are the whole model; effects come on top."""
        return ()

    def rate_name(self, state):
        """The state that an equation ``x' = v`` names, else ``x_rate``."""
        names = [c.name for c in self.coordinates]
        return self.form.rates[names.index(state)] if state in names else f"{state}_rate"

    def mass(self, q, p):
        """M(q, p)."""
        values = self._formula_values(q, SimpleNamespace(), None, p)
        return [_compute_formulas(row, values) for row in self.form.mass]

    def force(self, q, v, u, p):
        """f(q, q', z, u, p)."""
        return _compute_formulas(self.form.force, self._formula_values(q, v, u, p))

    def flows(self, q, v, u, p):
        """g(q, q', z, u, p)."""
        rates = _compute_formulas(self.form.flow, self._formula_values(q, v, u, p))
        return {s.name: rate for s, rate in zip(self.others, rates, strict=True)}

    def capacities(self, q, v, u, p):
        """D(q, q', z, u, p) over that at rest, of those states whose capacity changes."""
        if not self.form.capacities:
            return {}
        names, texts = zip(*self.form.capacities, strict=True)
        values = self._formula_values(q, v, u, p)
        return dict(zip(names, _compute_formulas(texts, values), strict=True))

    def _formula_values(self, q, v, u, p):
        """Name -> value of all that formulas may name."""
        values = {**vars(q), **vars(p)}
        values |= {self.rate_name(name): value for name, value in vars(v).items()}
        if u is not None:
            values |= {i.name: getattr(u, i.name) for i in self.inputs}
            rates = (i.rate.name for i in self.inputs if i.derivative)
            values |= {name: getattr(u, name) for name in rates}
            values |= {"t": u.time, "time": u.time}
        quantities = any(hasattr(value, "dimensionality") for value in values.values())
        for name, value, unit in self.form.definition.constants:
            values[name] = quantity(unit, value) if quantities else value
        return values

    def _formula_port(self, name, texts):
        from spiral.physics.formulas.equations import port_unit

        position, force = port_unit(self.form, texts, name)
        axes = texts if all(t.isidentifier() for t in texts) else _axis_names(len(texts))

        def coordinates(q, p):
            return _compute_formulas(texts, self._formula_values(q, SimpleNamespace(), None, p))

        return Port(name, tuple(axes), coordinates, position, force)


def _state_position(name):
    return lambda x, p: [getattr(x, name)]


def _axis_names(count):
    return ("x", "y", "z")[:count] if count < 4 else tuple(f"axis_{i + 1}" for i in range(count))


def _compute_formulas(texts, values):
    from spiral.physics.formulas import syntax

    return [syntax.compute(text, values) for text in texts]


@kept(32)
def _equation_ports(system):
    """Ports of a system of equations; cached, since placing many candidates asks for them often."""
    named = system.form.definition.ports
    if not system.coordinates:
        if named:
            raise ConfigError(
                f"ports: {', '.join(name for name, _ in named)}",
                "none, where no state is another's rate: every state is a port of its own name",
                "leave ports out; NAME-NAME is a place between two states of one unit",
            )
        return tuple(
            Port(s.name, (s.name,), _state_position(s.name), s.unit, per_second(s.unit))
            for s in system.others
        )
    taken = {text for _, texts in named for text in texts}
    derived = ((c.name, (c.name,)) for c in system.coordinates if c.name not in taken)
    known = {text.replace(" ", "") for text in taken}
    names = {name for name, _ in named} | {c.name for c in system.coordinates}
    between = (
        (f"{a.name}_{b.name}", (f"{b.name} - {a.name}",))
        for a, b in itertools.combinations(system.coordinates, 2)
        if a.unit == b.unit and not known & {f"{b.name}-{a.name}", f"{a.name}-{b.name}"}
    )
    own = [(name, texts) for name, texts in between if name not in names]
    ports = (*named, *derived, *own)
    made = [system._formula_port(name, texts) for name, texts in ports]
    more = _element_ports(system, ports)
    return (*made, *(system._formula_port(name, texts) for name, texts in more))


def _element_ports(system, ports):
    """Where springs and dampers of the equations are that stand at no other port.

    Such a port is called like its coordinates, or where that name is taken like the parameter.
    """
    from spiral.physics.formulas import syntax
    from spiral.physics.formulas.elements import element_deflections

    form, taken = system.form, {name for name, _ in ports}
    known = [texts[0] for _, texts in ports if len(texts) == 1]
    for parameter, text in element_deflections(form, known):
        used = syntax.names(text)
        joined = "_".join(c.name for c in form.coordinates if c.name in used)
        name = parameter if joined in taken else joined
        taken.add(name)
        yield name, (text,)
