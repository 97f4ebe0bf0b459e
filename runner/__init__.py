"""Experiments, storage and comparison."""
