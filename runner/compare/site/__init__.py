"""Results as a site: written to a folder that needs no server, or served live on this host."""

from seatrial.runner.compare.site.live_server import serve as serve
from seatrial.runner.compare.site.static_folder import write_site as write_site
