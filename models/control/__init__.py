"""Controllers: built from a model, they know nothing of where it came from."""
