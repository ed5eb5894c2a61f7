"""Trajectories and their sensitivities: windows, fits, scores, and filters."""
