"""NavSatFix <-> a place on the Earth."""

import math
from typing import TYPE_CHECKING

from star_tracker.earth.site import Site
from star_tracker.msg_adapters import MessageError

if TYPE_CHECKING:
    import sensor_msgs.msg
    import std_msgs.msg

#: The message's STATUS_FIX; what is below it is no fix, or not known.
_STATUS_FIX = 0


def site_from_fix(message: "sensor_msgs.msg.NavSatFix") -> Site:
    """Read where a receiver is. A receiver without an altitude stands on the ellipsoid.

    Raises MessageError where the receiver has no fix, or what it tells is no place.
    """
    if message.status.status < _STATUS_FIX:
        raise MessageError("NavSatFix status says that the receiver has no fix: wait for one")
    height = float(message.altitude)
    try:
        return Site(
            float(message.latitude), float(message.longitude),
            0.0 if math.isnan(height) else height,
        )
    except ValueError as error:
        raise MessageError(f"NavSatFix {error}") from error


def fix_from_site(site: Site, header: "std_msgs.msg.Header") -> "sensor_msgs.msg.NavSatFix":
    """Write a place as a fix whose covariance is not known."""
    from sensor_msgs.msg import NavSatFix, NavSatStatus

    message = NavSatFix(
        header=header, latitude=float(site.latitude_deg), longitude=float(site.longitude_deg),
        altitude=float(site.height_m), position_covariance_type=NavSatFix.COVARIANCE_TYPE_UNKNOWN,
    )
    message.status.status = NavSatStatus.STATUS_FIX
    message.status.service = NavSatStatus.SERVICE_GPS
    return message
