"""The default model: a temporal CNN proposes a slide, Gauss-Newton against the response map refines it."""
