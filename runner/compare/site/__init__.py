"""Results as a site: written to a folder that needs no server."""

from seatrial.runner.compare.site.static_folder import write_site as write_site
