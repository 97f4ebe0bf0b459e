"""What every test shares."""

from hypothesis import settings

# no deadline: the first call compiles; derandomized: a failure in one place is one everywhere
settings.register_profile("seatrial", deadline=None, derandomize=True)
settings.load_profile("seatrial")
