"""Simulation: the equation of motion, the closed loop and linear models of it."""
