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
# # Your own file
#
# From a CSV file to a model with its missing effects: read, compare, diagnose, add, discover,
# estimate. To have a file whose truth we know, we make one first: a mass on a spring that stiffens,
# with dry friction in its guide, shaken by a random force.

# %%
import pandas as pd

import spiral

pd.options.display.float_format = "{:.4g}".format

machine = spiral.simulate(
    "oscillator",
    duration=12.0,
    rate=500.0,
    inputs={"force": {"noise": 1.0, "band": [2, 40]}},
    effects=["cubic_stiffness", "coulomb_friction"],
    values={
        "system.mass": 1.2,
        "linear_stiffness.stiffness": 4e3,
        "linear_damping.damping": 6.0,
        "cubic_stiffness.stiffness": 2e9,
        "coulomb_friction.level": 0.25,
        "coulomb_friction.width": 1e-3,
    },
    noise_level=0.02,
    seed=3,
)
bench = {"t": machine.time, "q": 1e3 * machine.channels["x"], "f": machine.inputs["force"]}
pd.DataFrame(bench).to_csv("bench.csv", index=False)
pd.read_csv("bench.csv").head(3)

# %% [markdown]
# ## Read it
#
# Say which column is what, and its unit where it is not the system's own. This file has
# millimetres.

# %%
record = spiral.read(
    "bench.csv",
    "oscillator",
    time="t",
    channels={"x": "q"},
    inputs={"force": "f"},
    units={"x": "mm"},
)
record

# %% [markdown]
# ## Does the known physics fit?
#
# `oscillator` is $m\ddot x + c\dot x + kx = F$. The last fifth of the record is kept apart as the
# test: no fit sees it.

# %%
spiral.compare(record, "oscillator")

# %% [markdown]
# It does not: the error is far above the noise floor, the error that a perfect model would have.
#
# ## Where does it fail?

# %%
spiral.diagnose(record, "oscillator")

# %% [markdown]
# ## Find everything that is missing
#
# `discover` repeats that until nothing more passes.

# %%
run = spiral.discover(record, "oscillator")
run

# %%
spiral.plot.error_falling(run)

# %% [markdown]
# Each value has its standard error (`se`); `t` is their ratio. The truth that made the file is
# within two standard errors of every value.

# %%
run.estimates()

# %% [markdown]
# ## Try an effect of your choice
#
# `add` fits a model before and after. Drag adds nothing here: its coefficient is not significant
# (look at its t), and the error stays as it is.

# %%
before, after, with_drag = spiral.add(run, "quadratic_damping")
with_drag.estimates().loc[["quadratic_damping"]]

# %%
after

# %% [markdown]
# ## The velocity, which nobody measured
#
# A Kalman filter of the final model reconstructs all states, each with its standard deviation.

# %%
states = spiral.estimate(run, record)
states

# %% [markdown]
# ## Look at it, and take it away
#
# `spiral.plot.figures(run)` holds every figure of the report by name.

# %%
figures = spiral.plot.figures(run)
list(figures)

# %%
figures["surface"]

# %%
spiral.report(run, "report.html").name

# %%
print(spiral.export(run))
