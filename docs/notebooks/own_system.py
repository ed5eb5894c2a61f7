# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Your own system and your own effect
#
# The machine: a carriage with a smaller mass behind it on a spring. The sensor sees the carriage;
# the second mass is hidden. And an effect that no catalog has: dry friction that fades with speed.
# Each is one class.

# %% [markdown]
# ## The file
#
# Classes live in a file of a folder; a cell of a notebook can write it. A system names its states,
# inputs, parameters and ports, the places where effects act. Springs and dampers are effects of its
# seed, so their values are found like all others. `defaults` are nominal values, from a data sheet
# say: with a hidden mass the fit needs a place to begin.

# %%
from pathlib import Path

Path("plugins").mkdir(exist_ok=True)
Path("plugins/carriage.py").write_text('''
from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness

from spiral import ForceEffect, Input, MechanicalSystem, Parameter, Port, State
from spiral.math import exp, tanh


class Carriage(MechanicalSystem):
    """M q'' = force - K q - C q': a carriage x, and a hidden mass z behind it on a spring."""

    coordinates = (State("x", "m"), State("z", "m"))
    observed = ("x",)
    inputs = (Input("force", "N", interpolation="band_limited"),)
    injections = (State("x", "N"), State("z", "N"))
    parameters = (
        Parameter("first_mass", "kg", lower=0.0, start=1.0),
        Parameter("second_mass", "kg", lower=0.0, start=0.2),
    )
    ports = (
        Port("base", ("x",), lambda q, p: [q.x], "m", "N"),
        Port("coupling", ("x",), lambda q, p: [q.z - q.x], "m", "N"),
    )
    seed = (
        LinearStiffness(),
        LinearDamping(),
        LinearStiffness(port="coupling"),
        LinearDamping(port="coupling"),
    )
    defaults = {
        "linear_stiffness.stiffness": 400.0,
        "linear_damping.damping": 1.0,
        "linear_stiffness@coupling.stiffness": 100.0,
        "linear_damping@coupling.damping": 0.3,
    }

    def mass(self, q, p):
        """The masses, in kg."""
        return [[p.first_mass, 0], [0, p.second_mass]]

    def force(self, q, v, u, p):
        """The force on the carriage, in N."""
        return [u.force, 0]


class FadingFriction(ForceEffect):
    """Dry friction that fades with speed: F = -F_s exp(-(v / v_s)^2) tanh(v / w)."""

    parameters = (
        Parameter("level", "force", lower=0.0, per_axis=True),
        Parameter("fading", "velocity", lower=0.0, start=0.05, role="shape"),
        Parameter("width", "velocity", lower=0.0, start=0.01, role="shape"),
    )

    def force(self, at, u, p):
        """The friction on each axis of the port, against its velocity."""
        return [
            -level * exp(-((v / p.fading) ** 2)) * tanh(v / p.width)
            for level, v in zip(p.level, at.velocity)
        ]
''')
# %% [markdown]
# `spiral check carriage` on the command line tests such a file: units, derivatives, behaviour at
# rest. Here we use it at once. Plugins are found in `./plugins`; another folder is named by
# `plugins=`.

# %%
import pandas as pd

import spiral

pd.options.display.float_format = "{:.4g}".format

record = spiral.simulate(
    "carriage",
    duration=8.0,
    rate=800.0,
    inputs={"force": {"noise": 2.0, "band": [0.5, 15]}},
    effects=["fading_friction"],
    values={
        "linear_stiffness.stiffness": 460.0,
        "linear_stiffness@coupling.stiffness": 80.0,
        "fading_friction.level": 0.4,
    },
    noise_level=0.01,
    seed=1,
)
record

# %% [markdown]
# ## Find it
#
# The springs of this machine differ from the data sheet: 460 N/m in place of 400, and 80 in place
# of 100. The new effect is a candidate beside those of the catalog.

# %%
candidates = ["fading_friction", "coulomb_friction", "quadratic_damping", "cubic_stiffness"]
run = spiral.discover(record, "carriage", candidates=candidates)
run

# %% [markdown]
# The two masses are known and not fitted, so they have no standard error.

# %%
run.estimates()

# %% [markdown]
# ## What the hidden mass does
#
# A Kalman filter of the model reconstructs it from the carriage's motion alone. The record is
# simulated, so the true motion is known, and the error of each state can be told: below 0.1 %. The
# bands know of the noise but not of the parameters' own errors, so they hold the truth less often
# than in 95 % of the samples.

# %%
spiral.estimate(run, record)

# %% [markdown]
# ## Without a file
#
# A class that is defined in a cell makes an object, and an object stands wherever a name does.

# %%
from spiral import ForceEffect, Parameter
from spiral.math import tanh


class Grip(ForceEffect):
    """A guide that grips: F = -F_c tanh(v / w)."""

    parameters = (
        Parameter("level", "force", lower=0.0),
        Parameter("width", "velocity", lower=0.0, start=0.01, role="shape"),
    )

    def force(self, at, u, p):
        """Against the velocity."""
        return [-p.level * tanh(v / p.width) for v in at.velocity]


spiral.diagnose(record, "carriage", candidates=[Grip(), *candidates[:1]])
