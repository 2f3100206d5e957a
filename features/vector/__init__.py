"""The feature vector of a window, for the classical models."""
