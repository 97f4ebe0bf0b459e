"""The Python interface: trials, results, models and recordings as objects; see `seatrial`."""
