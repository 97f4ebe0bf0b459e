"""Vessels: coefficient tables over basis functions, thrusters and their allocation."""
