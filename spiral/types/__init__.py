"""The data types: records, systems, ports, effects, models, runs, kinds of plugins; no numerics."""
