"""`make lab`: a simulated recording session, from a bare skin to a model, without hardware."""
