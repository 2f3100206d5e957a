"""Bundles, and their other formats."""
