"""Slides along a path, put together from presses on a grid of places."""
