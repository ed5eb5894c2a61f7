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
# # A rotor whose tilt nobody measured
#
# A rotor slows down from 40 Hz to rest. Two sensors see its displacements x and y, with 2 % noise.
# The disk also tilts, and no sensor sees that. We start from a model that knows nothing of the tilt
# and let `spiral` find what it is missing.

# %%
import pandas as pd

import spiral

pd.options.display.float_format = "{:.4g}".format

# %% [markdown]
# ## Two records
#
# The run-down comes with the package. The second record is the same machine on another day: other
# noise, and another angle between the phase mark on the shaft and the unbalance. No fit sees it; it
# is the test.

# %%
record = spiral.read({"name": "rotor_coastdown", "seed": 11, "phase": 0.4}, "planar_rotor")
test = spiral.read({"name": "rotor_coastdown", "seed": 1011, "phase": 1.3}, "planar_rotor")
record

# %% [markdown]
# ## What is missing?
#
# `planar_rotor` is what the sensors see: two springs, two dampers and an unbalance. `discover` fits
# it, ranks all effects of the catalog by how much of the remaining error each explains, adds the
# best one that passes the tests on data it was not selected on, and begins again.

# %%
run = spiral.discover(record, "planar_rotor", test=test)
run

# %% [markdown]
# The *test error* is that of a free run: the model starts from the first moments of the test record
# and never looks at x and y again. It is relative to the standard deviation of each channel.

# %%
spiral.plot.error_falling(run)

# %% [markdown]
# ## What it says about the tilt
#
# The gyroscopic coupling belongs to the tilts. What is left of it in x and y is a force across the
# velocity, and its coefficient can be compared with the one that follows from the full equations
# with tilts, 4.80e-3.

# %%
run.estimates().loc[["gyroscopic", "cross_stiffness", "cubic_stiffness"]]

# %%
print(spiral.export(run))

# %% [markdown]
# ## Measured and predicted
#
# The final model beside the test record. The lower curve of each pair is what is left.

# %%
spiral.plot.measured(run)
