"""Shipped plugins: libraries."""
