"""Shipped plugins: observers."""
