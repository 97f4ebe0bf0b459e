"""Many trials: planned, launched, ended and shown."""
