"""`make lab`: the whole hour, from a bare skin to a model, without hardware."""
