"""Readers of recorded files, one a format."""
