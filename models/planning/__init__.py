"""Paths of manoeuvres through restricted waters."""
