"""Configurations, installed as ``spiral_conf``."""
