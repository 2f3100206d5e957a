"""Benchmarks of making data, with FElupe as the reference solver."""
