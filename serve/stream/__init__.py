"""From a source of samples to sinks of estimates."""
