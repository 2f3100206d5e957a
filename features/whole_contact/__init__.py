"""The path of a whole contact, once it has been recorded to its end."""
