"""The report of a saved run: figures, one page, pictures. Reads ``run.json`` and ``curves.npz``.

``style``: one look. ``motion``, ``maps``, ``evidence``: the figures. ``html``: one HTML file that
opens with no network. ``pictures``: a figure as PNG, by a browser without a window.
"""
