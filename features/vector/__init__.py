"""From a window to its named features, the input of the classical models."""
