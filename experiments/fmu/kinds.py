"""Five kinds of machines, each as equations for the exporter and as hand-written C."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Kind:
    """A machine.

    ``equations`` have ``{NAME}`` where a force on the coordinate NAME enters; ``forces`` are the
    units of these forces. ``drive`` is the rms and the band (Hz) of the input, ``nominal`` sizes of
    the states for the C program's description.
    """

    name: str
    equations: tuple[str, ...]
    states: Mapping[str, str]
    input: tuple[str, str]
    forces: Mapping[str, str]
    parameters: Mapping[str, tuple[float, str]]
    free: tuple[str, ...]
    observed: tuple[str, ...]
    drive: tuple[float, tuple[float, float]]
    rate: float
    samples: int = 4000

    @property
    def coordinates(self) -> tuple[str, ...]:
        """States on which a force may act."""
        return tuple(self.forces)

    def force_input(self, coordinate: str) -> str:
        """The input of the FMU that a force on a coordinate goes through."""
        return f"F_{coordinate}"


@dataclass(frozen=True)
class Case:
    """A machine with something hidden, and how its FMU is made: ``2``, ``3`` or ``C``."""

    kind: str
    way: str
    effect: str
    values: Mapping[str, float]

    @property
    def name(self) -> str:
        """For tables."""
        return f"{self.kind}, {self.way}"


KINDS = {k.name: k for k in (
    Kind(
        "drive",
        ("J1*a'' = T + k*(b - a) + c*(b' - a') - p*a - d*a' + {a}",
         "J2*b'' = -k*(b - a) - c*(b' - a') + {b}"),
        {"a": "rad", "b": "rad"}, ("T", "N*m"), {"a": "N*m", "b": "N*m"},
        {"J1": (0.02, "kg*m^2"), "J2": (0.05, "kg*m^2"), "k": (200.0, "N*m/rad"),
         "c": (0.1, "N*m*s/rad"), "p": (20.0, "N*m/rad"), "d": (0.3, "N*m*s/rad")},
        ("k", "c"), ("a",), (1.0, (0.5, 30.0)), 400.0,
    ),
    Kind(
        "quarter_car",
        ("mb*b'' = -k*(b - w) - c*(b' - w') + {b}",
         "mw*w'' = k*(b - w) + c*(b' - w') - kt*(w - road) + {w}"),
        {"b": "m", "w": "m"}, ("road", "m"), {"b": "N", "w": "N"},
        {"mb": (300.0, "kg"), "mw": (40.0, "kg"), "k": (16000.0, "N/m"), "c": (1000.0, "N*s/m"),
         "kt": (180000.0, "N/m")},
        ("k", "c"), ("b",), (0.01, (0.5, 15.0)), 200.0,
    ),
    Kind(
        "cylinder",
        ("m*x'' = A*P - d*x' - k*x + {x}", "P' = E*(g*u - A*x' - l*P)"),
        {"x": "m", "P": "Pa"}, ("u", "V"), {"x": "N"},
        {"m": (50.0, "kg"), "A": (1e-3, "m^2"), "d": (500.0, "N*s/m"), "k": (1e5, "N/m"),
         "E": (1e12, "Pa/m^3"), "g": (1e-5, "m^3/s/V"), "l": (1e-11, "m^3/s/Pa")},
        ("d", "k"), ("x", "P"), (3.0, (0.5, 20.0)), 400.0,
    ),
    Kind(
        "pendulum",
        ("J*th'' = T - d*th' - G*sin(th) + {th}",),
        {"th": "rad"}, ("T", "N*m"), {"th": "N*m"},
        {"J": (0.1, "kg*m^2"), "d": (0.05, "N*m*s/rad"), "G": (3.0, "N*m")},
        ("d", "G"), ("th",), (0.3, (0.1, 2.0)), 100.0,
    ),
    Kind(
        "loudspeaker",
        ("m*x'' = B*i - d*x' - k*x + {x}", "L*i' = U - R*i - B*x'"),
        {"x": "m", "i": "A"}, ("U", "V"), {"x": "N"},
        {"m": (0.02, "kg"), "d": (1.0, "N*s/m"), "k": (2000.0, "N/m"), "B": (5.0, "N/A"),
         "R": (6.0, "V/A"), "L": (5e-3, "V*s/A")},
        ("d", "k"), ("x",), (5.0, (5.0, 150.0)), 2000.0,
    ),
)}  # fmt: skip

CASES = (
    Case("drive", "2", "coulomb_friction@b", {"level": 0.3, "width": 0.05}),
    Case("drive", "C", "cubic_stiffness@a_b", {"stiffness": 5e5}),
    Case("quarter_car", "3", "cubic_stiffness@b_w", {"stiffness": 3e7}),
    Case("quarter_car", "C", "quadratic_damping@b_w", {"damping": 4000.0}),
    Case("cylinder", "2", "coulomb_friction@x", {"level": 60.0, "width": 2e-3}),
    Case("cylinder", "C", "quadratic_loss@P", {"rate": 3e-5}),
    Case("pendulum", "3", "quadratic_damping@th", {"damping": 0.03}),
    Case("pendulum", "C", "coulomb_friction@th", {"level": 0.05, "width": 0.05}),
    Case("loudspeaker", "2", "cubic_stiffness@x", {"stiffness": 2e8}),
    Case("loudspeaker", "C", "quadratic_damping@x", {"damping": 2.0}),
)
