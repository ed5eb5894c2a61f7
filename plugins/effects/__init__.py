"""Shipped plugins: effects."""
