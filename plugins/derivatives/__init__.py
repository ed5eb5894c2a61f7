"""Shipped plugins: estimators of derivatives."""
