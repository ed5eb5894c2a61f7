"""A linear structure by its matrices, reduced to the nodes that matter and a few modes."""

from __future__ import annotations

from typing import Any

from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.rates import per_second
from spiral.types.system import MechanicalSystem
from spiral.types.units import quantity, short_form


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
            source, nodes = (self.path, self.nodes) if self.path else _chain_example()
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
    def exact_to(self):
        """The end of the band: above it modes carry what they do inside it."""
        return self.form.band[1]

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
        return tuple(State(c.name, _unit_of_force(c.unit)) for c in self.coordinates)

    @property
    def observed(self):
        """Nodes with a sensor, and NODE_acceleration of those with an accelerometer."""
        return (*self._nodes_with_use("sensor"), *(state.name for state in self.readings))

    @property
    def readings(self):
        """What accelerometers report."""
        units = dict(zip(self.form.names, self.form.units, strict=True))
        nodes = self._nodes_with_use("accelerometer")
        return tuple(State(f"{n}_acceleration", short_form(per_second(units[n], 2))) for n in nodes)

    def reading(self, x, rates, u, p):
        """q'' of each such node."""
        nodes = self._nodes_with_use("accelerometer")
        return {f"{n}_acceleration": getattr(rates, self.rate_name(n)) for n in nodes}

    @property
    def inputs(self):
        """A force on each node that has one, named force_NODE; the speed where there is G."""
        units = dict(zip(self.form.names, self.form.units, strict=True))
        forces = (
            Input(f"force_{n}", _unit_of_force(units[n]), "band_limited")
            for n in self._nodes_with_use("input")
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
            Port(name, (name,), _node_difference(a, b), units[a], _unit_of_force(units[a]))
            for name, a, b in self.form.pairs
        )
        seen = self._nodes_with_use("sensor") or self._nodes_with_use("accelerometer")
        single = self._nodes_with_use("port") or (() if pairs else seen)
        at = tuple(
            Port(n, (n,), _node_position(n), units[n], _unit_of_force(units[n])) for n in single
        )
        return (*at, *pairs)

    @property
    def seed(self):
        """The matrices are the whole model; effects come on top."""
        return ()

    def mass(self, q, p):
        """M."""
        values = self.form.mass.tolist()
        if not _have_any_units([*vars(q).values(), *vars(p).values()]):
            return values
        units = self.form.units
        per = [[f"({_unit_of_force(a)})*s^2/({b})" for b in units] for a in units]
        return [
            [v * quantity(u, 1.0) for v, u in zip(*rows, strict=True)]
            for rows in zip(values, per, strict=True)
        ]

    def force(self, q, v, u, p):
        """F - (C + W G) q' - s K q."""
        units, states = self.form.units, (list(vars(q).values()), list(vars(v).values()))
        return [
            total
            - sum(
                self._matrix_forces(
                    self._scaled_matrices(u, p), states, i, _unit_of_force(units[i])
                )
            )
            for i, total in enumerate(self._applied_forces(u))
        ]

    def rate(self, x, u, p, injected):
        """q' = v, v' = M^-1 (F + injected) - M^-1 (C + W G) q' - s M^-1 K q, in which few are full.

        Products with M^-1 are numbers: every mode by itself.
        """
        form, (q, v) = self.form, self.split(x)
        pushes = [f + injected[n] for n, f in zip(form.names, self._applied_forces(u), strict=True)]
        scaled = [(f, form.divide_by_mass(m), kind) for f, m, kind in self._scaled_matrices(u, p)]
        states = (list(vars(q).values()), list(vars(v).values()))
        rates = {n: getattr(v, n) for n in form.names}
        for i, name in enumerate(form.names):
            own = f"({form.units[i]})/s^2"
            total = sum(
                (
                    value
                    * (
                        quantity(f"({own})/({_unit_of_force(unit)})", 1.0)
                        if _have_any_units([push])
                        else 1
                    )
                    * push
                    for value, push, unit in zip(
                        form.compliance[i].tolist(), pushes, form.units, strict=True
                    )
                    if _have_any_units([push]) or push != 0
                )
            )
            rates[self.rate_name(name)] = total - sum(self._matrix_forces(scaled, states, i, own))
        return rates

    def _applied_forces(self, u):
        """The recorded force on each coordinate."""
        inputs = dict(zip(self._nodes_with_use("input"), self.inputs, strict=False))
        return [getattr(u, inputs[n].name) if n in inputs else 0 for n in self.form.names]

    def _scaled_matrices(self, u, p):
        """Factors and their matrices, of the coordinates (0) or of their rates (1)."""
        form = self.form
        terms = [(p.stiffness, form.stiffness, 0)]
        terms += [(getattr(p, name), part, 0) for name, part in form.parts.items()]
        terms += [(p.damping_ratio if form.by_ratio else p.damping, form.damping, 1)]
        return terms if form.gyroscopic is None else [*terms, (u.speed, form.gyroscopic, 1)]

    def _matrix_forces(self, scaled, states, row, own):
        """A row of each matrix times states, times its factor."""
        for factor, matrix, kind in scaled:
            yield factor * sum(self._row_terms(matrix, states[kind], row, kind, factor, own))

    def _row_terms(self, matrix, states, row, kind, factor, own):
        """The terms of a row of a matrix times states, in ``own`` unit where these have some."""
        per = "" if getattr(factor, "dimensionless", True) else "*s/rad"
        for value, state, unit in zip(matrix[row], states, self.form.units, strict=True):
            if value and _have_any_units([state]):
                unit_of_factor = f"({own})*{'s' if kind else '1'}/({unit}){per}"
                yield value * quantity(unit_of_factor, 1.0) * state
            elif value:
                yield float(value) * state

    def _nodes_with_use(self, use):
        return tuple(
            n for n, uses in zip(self.form.names, self.form.uses, strict=False) if use in uses
        )


def _unit_of_force(unit):
    return "N*m" if unit == "rad" else "N"


def _node_position(name):
    return lambda q, p: [getattr(q, name)]


def _node_difference(first, second):
    return lambda q, p: [getattr(q, second) - getattr(q, first)]


def _have_any_units(values):
    return any(hasattr(v, "dimensionality") for v in values)


def _chain_example():
    """Three masses of 1 kg on springs of 1 N/m, a sensor and a force on the first."""
    import numpy as np

    stiffness = 2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)
    nodes = {"first": {"dof": 0, "use": "sensor input port"}, "last": {"dof": 2, "use": "port"}}
    return {"M": np.eye(3), "K": stiffness}, nodes
