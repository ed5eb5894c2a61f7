"""MLflow's record of every run: a parent run for each study, a child for each of its rounds.

``content``: what is logged, as plain data. ``store``: where it goes. ``track``: saved runs into a
store. ``served``: a saved run as an MLflow model. Only a parent process writes; what it writes is
read from saved runs, so that tracking can fail, or be caught up, without a result being lost.
"""
