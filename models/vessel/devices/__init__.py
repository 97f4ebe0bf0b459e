"""Devices: the forces that the inputs of a vessel produce in the motion through the water."""
