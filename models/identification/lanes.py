"""What the kernels for many candidates share: how many stand side by side, and their errors."""

LANES = 128
METRICS = ("mae", "mse", "smape", "mean_error")
MAE, MSE, SMAPE, MEAN_ERROR = range(4)
