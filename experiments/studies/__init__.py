"""Studies, a question each."""
