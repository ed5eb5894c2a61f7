"""The words of the project: records, systems, ports, effects, models, runs; no numerics."""
