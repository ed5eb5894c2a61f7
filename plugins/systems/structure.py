"""A linear structure by its matrices, reduced to the nodes that matter and a few modes."""

from __future__ import annotations

from typing import Any

from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.rates import per_second
from spiral.types.system import MechanicalSystem
from spiral.types.units import short_form


class Structure(MechanicalSystem):
    """M q'' + (C + W G) q' + s K q = F: kept nodes and modes with the nodes held (Craig, Bampton).

    Without C every mode has one damping ratio. W is the speed in rad/s, s the stiffness relative to
    K; a part K_NAME of the stiffness has a factor of its own, NAME.

    Fields
    ------
    path : NPZ or MAT file with M and K, where there are also C, G and parts K_NAME.
    nodes : CSV file with the columns name, dof, unit, use (of sensor, accelerometer, input, port,
        end).
    size : coordinates that are left, nodes and modes.
    band : low and high frequency, Hz, of the comparison with the full structure.
    pairs : port between two nodes -> their names.
    damping_ratio : of every mode, where there is no C.
    highest : Hz, to which higher modes are lowered by mass; four times the band's end if left out.
    text : the reduced structure, which needs no file; with neither, a chain of masses.
    """

    path: str = ""
    nodes: str = ""
    size: int = 20
    band: tuple[float, ...] = ()
    pairs: Any = None
    damping_ratio: float = 0.01
    highest: float | None = None
    text: str = ""

    def __post_init__(self):
        """Read and reduce, so that what is wrong is said at once."""
        from spiral.io.readers.matrices import read_structure
        from spiral.physics.structures.description import structure_of

        object.__setattr__(self, "band", tuple(self.band))
        if not self.text:
            source, nodes = (self.path, self.nodes) if self.path else _chain()
            band = self.band if self.path else (0.0, 0.3)
            kind = (self.size, band, self.pairs, self.damping_ratio, self.highest)
            text = read_structure(source, nodes, *kind)
            object.__setattr__(self, "text", text)
        object.__setattr__(self, "pairs", None)  # they are in the text
        structure_of(self.text)

    @property
    def form(self):
        """Matrices and names."""
        from spiral.physics.structures.description import structure_of

        return structure_of(self.text)

    @property
    def report(self):
        """How far the reduced structure is from the full one."""
        return self.form.report

    @property
    def coordinates(self):
        """The kept nodes, then the modes."""
        return tuple(State(n, u) for n, u in zip(self.form.names, self.form.units, strict=True))

    @property
    def injections(self):
        """A force on each node and mode."""
        return tuple(State(c.name, _force(c.unit)) for c in self.coordinates)

    @property
    def observed(self):
        """Nodes with a sensor, and NODE_acceleration of those with an accelerometer."""
        return (*self._nodes("sensor"), *(state.name for state in self.readings))

    @property
    def readings(self):
        """What accelerometers report."""
        units = dict(zip(self.form.names, self.form.units, strict=True))
        nodes = self._nodes("accelerometer")
        return tuple(State(f"{n}_acceleration", short_form(per_second(units[n], 2))) for n in nodes)

    def reading(self, x, rates, u, p):
        """q'' of each such node."""
        nodes = self._nodes("accelerometer")
        return {f"{n}_acceleration": getattr(rates, self.rate_name(n)) for n in nodes}

    @property
    def inputs(self):
        """A force on each node that has one, named force_NODE; the speed where there is G."""
        units = dict(zip(self.form.names, self.form.units, strict=True))
        forces = (
            Input(f"force_{n}", _force(units[n]), "band_limited") for n in self._nodes("input")
        )
        turning = (Input("speed", "rad/s"),) if self.form.gyroscopic is not None else ()
        return (*forces, *turning)

    @property
    def parameters(self):
        """Factors of stiffness, its parts and damping, known unless they are freed."""
        kinds = ("damping_ratio", self.form.ratio) if self.form.by_ratio else ("damping", 1.0)
        factors = [("stiffness", 1.0), kinds, *((name, 1.0) for name in self.form.parts)]
        return tuple(Parameter(name, "", lower=0.0, start=start) for name, start in factors)

    @property
    def ports(self):
        """Pairs of nodes, then nodes of use port; without any, those that are measured."""
        units = dict(zip(self.form.names, self.form.units, strict=True))
        pairs = tuple(
            Port(name, (name,), _between(a, b), units[a], _force(units[a]))
            for name, a, b in self.form.pairs
        )
        seen = self._nodes("sensor") or self._nodes("accelerometer")
        single = self._nodes("port") or (() if pairs else seen)
        at = tuple(Port(n, (n,), _at(n), units[n], _force(units[n])) for n in single)
        return (*at, *pairs)

    @property
    def seed(self):
        """The matrices are the whole model; effects come on top."""
        return ()

    def mass(self, q, p):
        """M."""
        values = self.form.mass.tolist()
        if not _have_units([*vars(q).values(), *vars(p).values()]):
            return values
        units = self.form.units
        per = [[f"({_force(a)})*s^2/({b})" for b in units] for a in units]
        return [
            [v * _one(u) for v, u in zip(*rows, strict=True)]
            for rows in zip(values, per, strict=True)
        ]

    def force(self, q, v, u, p):
        """F - (C + W G) q' - s K q."""
        units, states = self.form.units, (list(vars(q).values()), list(vars(v).values()))
        return [
            total - sum(self._pulls(self._scaled(u, p), states, i, _force(units[i])))
            for i, total in enumerate(self._applied(u))
        ]

    def rate(self, x, u, p, injected):
        """q' = v, v' = M^-1 (F + injected) - M^-1 (C + W G) q' - s M^-1 K q, in which few are full.

        Products with M^-1 are numbers: every mode by itself.
        """
        form, (q, v) = self.form, self.split(x)
        pushes = [f + injected[n] for n, f in zip(form.names, self._applied(u), strict=True)]
        scaled = [(f, form.accelerated(m), kind) for f, m, kind in self._scaled(u, p)]
        states = (list(vars(q).values()), list(vars(v).values()))
        rates = {n: getattr(v, n) for n in form.names}
        for i, name in enumerate(form.names):
            own = f"({form.units[i]})/s^2"
            total = sum(
                (value * (_one(f"({own})/({_force(unit)})") if _have_units([push]) else 1) * push
                for value, push, unit in zip(
                    form.compliance[i].tolist(), pushes, form.units, strict=True)
                if _have_units([push]) or push != 0)
            )  # fmt: skip
            rates[self.rate_name(name)] = total - sum(self._pulls(scaled, states, i, own))
        return rates

    def _applied(self, u):
        """The recorded force on each coordinate."""
        inputs = dict(zip(self._nodes("input"), self.inputs, strict=False))
        return [getattr(u, inputs[n].name) if n in inputs else 0 for n in self.form.names]

    def _scaled(self, u, p):
        """Factors and their matrices, of the coordinates (0) or of their rates (1)."""
        form = self.form
        found = [(p.stiffness, form.stiffness, 0)]
        found += [(getattr(p, name), part, 0) for name, part in form.parts.items()]
        found += [(p.damping_ratio if form.by_ratio else p.damping, form.damping, 1)]
        return found if form.gyroscopic is None else [*found, (u.speed, form.gyroscopic, 1)]

    def _pulls(self, scaled, states, row, own):
        """A row of each matrix times states, times its factor."""
        for factor, matrix, kind in scaled:
            yield factor * sum(self._terms(matrix, states[kind], row, kind, factor, own))

    def _terms(self, matrix, states, row, kind, factor, own):
        """The terms of a row of a matrix times states, in ``own`` unit where these have some."""
        per = "" if getattr(factor, "dimensionless", True) else "*s/rad"
        for value, state, unit in zip(matrix[row], states, self.form.units, strict=True):
            if value and _have_units([state]):
                yield value * _one(f"({own})*{'s' if kind else '1'}/({unit}){per}") * state
            elif value:
                yield float(value) * state

    def _nodes(self, use):
        return tuple(
            n for n, uses in zip(self.form.names, self.form.uses, strict=False) if use in uses
        )


def _force(unit):
    return "N*m" if unit == "rad" else "N"


def _at(name):
    return lambda q, p: [getattr(q, name)]


def _between(first, second):
    return lambda q, p: [getattr(q, second) - getattr(q, first)]


def _have_units(values):
    return any(hasattr(v, "dimensionality") for v in values)


def _one(unit):
    from spiral.types.units import registry

    return registry().Quantity(1.0, unit.replace("^", "**"))


def _chain():
    """Three masses of 1 kg on springs of 1 N/m, a sensor and a force on the first."""
    import numpy as np

    stiffness = 2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)
    nodes = {"first": {"dof": 0, "use": "sensor input port"}, "last": {"dof": 2, "use": "port"}}
    return {"M": np.eye(3), "K": stiffness}, nodes
