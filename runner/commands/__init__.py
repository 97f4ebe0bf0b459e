"""What `seatrial` does beside trials: recordings, models, drafts, the benchmark."""
