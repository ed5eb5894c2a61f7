"""Systems whose rates only a program knows: what an FMU and a compiled function have in common."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from types import SimpleNamespace

from spiral_plugins.systems.equations import Equations

from spiral.types.cache import kept
from spiral.types.system import MechanicalSystem


class Outside(MechanicalSystem):
    """x' = f(t, x, u, p) of a program, with forces added to its inputs or to its rates."""

    @property
    @abstractmethod
    def wrapped(self):
        """The program, and equations around it (``spiral.physics.outside.wrapped``)."""

    @property
    def form(self):
        """The equations around it, as a system of their own."""
        return _surrounding_equations(self.wrapped.text)

    @property
    def balanced(self):
        """Masses and forces are inside the program."""
        return False

    @property
    def coordinates(self):
        """States whose rate is another state."""
        return self.form.coordinates

    @property
    def others(self):
        """States of first order."""
        return self.form.others

    @property
    def injections(self):
        """A force on each coordinate, a flow into each other state."""
        units = {c: unit for c, _, unit in self.wrapped.pushed}
        return tuple(replace(i, unit=units.get(i.name, i.unit)) for i in self.form.injections)

    @property
    def observed(self):
        """What is measured."""
        return self.form.observed

    @property
    def readings(self):
        """Channels that are a formula."""
        return self.form.readings

    def reading(self, x, rates, u, p):
        """h(x, x', u, p) of each; the rates that the program gives are x' already."""
        given = {name: 0 for i in self.form.inputs for name in (i.name, i.rate.name)}
        return self.form.reading(x, rates, SimpleNamespace(**{**given, **vars(u)}), p)

    @property
    def inputs(self):
        """Inputs that are recorded."""
        return tuple(i for i in self.form.inputs if i.name in self.wrapped.recorded)

    @property
    def parameters(self):
        """Those that are not named free are known."""
        return self.form.parameters

    @property
    def defaults(self):
        """First values of parameters that are to be found."""
        return self.form.defaults

    @property
    def ports(self):
        """Those that are named, and one between any two of one unit; else each coordinate."""
        return _reachable_ports(self)

    @property
    def seed(self):
        """The program is the whole model; effects come on top."""
        return ()

    def rate_name(self, state):
        """The state that is the rate of another."""
        return self.form.rate_name(state)

    def mass(self, q, p):
        """M of the equations around: 1, or what was stated."""
        return self.form.mass(q, p)

    def force(self, q, v, u, p):
        """f of the equations around, without effects."""
        x = SimpleNamespace(**vars(q), **{self.rate_name(n): value for n, value in vars(v).items()})
        return self.form.force(q, v, self._with_program_rates(x, u, p, {}), p)

    def rate(self, x, u, p, injected):
        """Forces through inputs are the program's affair, the others add to its rates."""
        through = {c for c, _, _ in self.wrapped.pushed}
        left = {n: 0 if n in through else value for n, value in injected.items()}
        return self.form.rate(x, self._with_program_rates(x, u, p, injected), p, left)

    def _with_program_rates(self, x, u, p, injected):
        """The inputs, with the program's rates among them."""
        return SimpleNamespace(**{**vars(u), **self.wrapped.rates(x, u, p, injected)})


@kept(32)
def _surrounding_equations(text):
    return Equations(text=text)


@kept(32)
def _reachable_ports(system):
    """Ports that forces reach through inputs where these are named; else those of the equations.

    A force per unit mass has no counterforce: without inputs and masses no port is between two.
    """
    form, units = system.form, {c: unit for c, _, unit in system.wrapped.pushed}
    if not form.coordinates or form.form.definition.mass:
        return form.ports
    names, ports = [c.name for c in form.coordinates], []
    for port in form.ports:
        used = [n for n in names if _depends_on_coordinate(form, port, n)]
        if not units and len(used) == 1:
            ports.append(port)
        elif used and {units.get(n) for n in used} == {units.get(used[0])} != {None}:
            ports.append(replace(port, force_unit=units[used[0]]))
    return tuple(ports)


def _depends_on_coordinate(system, port, name):
    """Whether the position at a port depends on a coordinate."""
    import sympy

    coordinates = {c.name: sympy.Symbol(c.name) for c in (*system.coordinates, *system.others)}
    p = SimpleNamespace(**{q.name: sympy.Symbol(q.name) for q in system.parameters})
    positions = port.coordinates(SimpleNamespace(**coordinates), p)
    return any(coordinates[name] in sympy.sympify(e).free_symbols for e in positions)
