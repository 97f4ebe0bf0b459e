"""Excitations: missions, manoeuvres and force signals for identification."""
