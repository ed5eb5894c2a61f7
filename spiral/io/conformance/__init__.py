"""Checks of ``spiral check``, by kind of plugin: each returns what it saw, or raises an error."""
