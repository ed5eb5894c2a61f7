"""Where a model fails: speeds, orders, frequencies, amplitudes, and the state of the missing force.

``regions``: the ranges and their sentence. ``orders``: spectra by order. ``latent``: the missing
force with its uncertainty. ``surface``: the state that the force follows.
"""
