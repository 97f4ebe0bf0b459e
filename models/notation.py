"""Degrees of freedom and the letters of their motion, as in Fossen (2021), Table 2.1."""

DOFS = ("surge", "sway", "heave", "roll", "pitch", "yaw")
VELOCITIES = ("u", "v", "w", "p", "q", "r")
ACCELERATIONS = tuple(f"{name}_dot" for name in VELOCITIES)
