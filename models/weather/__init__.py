"""Weather: wind, waves, current and noise, and the disturbance cases made of them."""
