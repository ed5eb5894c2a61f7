"""The shipped plugins, installed as ``spiral_plugins``."""
