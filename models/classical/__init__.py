"""The classical models: one file each."""
