"""An open benchmark: tasks on measured and simulated ships, entrants, scores and their ranks."""
