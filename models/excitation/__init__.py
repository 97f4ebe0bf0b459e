"""Excitations: what a vessel is made to do so that it can be identified."""
