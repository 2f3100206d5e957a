"""C99 generated from a graph."""
