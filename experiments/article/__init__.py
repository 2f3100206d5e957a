"""The article redone: its figures, its claims and its method on the recordings at hand."""
