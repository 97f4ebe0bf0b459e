"""The page of what fits what: `python -m docs.fits`, in about a minute."""

import os

from seatrial.runner.commands import fits

if __name__ == "__main__":
    os.environ["COLUMNS"] = "100"
    print("```text")
    fits.main([])
    print("```")
