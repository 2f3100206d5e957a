"""The tracked hyperparameter search."""
