"""Recordings: measured or simulated motion and force, read, checked and cleaned."""
