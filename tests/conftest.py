"""What every test shares."""

from hypothesis import settings

settings.register_profile("seatrial", deadline=None)  # the first call compiles
settings.load_profile("seatrial")

