"""Star maps as a bag: their centroids, or images rendered of their sky, with CameraInfo."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from star_tracker.bags.writing import BagWriter
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.detection.render import render
from star_tracker.detection.render_settings import RenderSettings
from star_tracker.maps.star_map import StarMap
from star_tracker.msg_adapters.camera_info import info_from_camera
from star_tracker.msg_adapters.centroids import Centroids
from star_tracker.msg_adapters.image import Picture, image_from_picture
from star_tracker.msg_adapters.point_cloud import cloud_from_centroids
from star_tracker.optics.camera import PIXEL_ORIGINS

#: Stamp of the first frame: 2000-01-01, 00:00 UTC.
START_NS = 946_684_800_000_000_000
_INFO, _CENTROIDS, _IMAGE = "/camera_info", "/centroids", "/image"


@dataclass(frozen=True)
class Recording:
    """How maps become the frames of a bag.

    Attributes:
        rate_hz: frames a second.
        frame_id: of their headers.
        rendered: what images are rendered with; None for centroids.
        limiting_magnitude: of the stars that are rendered.
    """

    rate_hz: float = 10.0
    frame_id: str = "camera"
    rendered: RenderSettings | None = None
    limiting_magnitude: float = 7.5


def record_maps(writer: BagWriter, maps: Sequence[StarMap], recording: Recording) -> None:
    """Write maps as `centroids` or `image`, each after its `camera_info`, in order.

    The centroids are those of the map. An image shows the sky at the map's pose, without the
    map's displaced and missing stars, each of another seed. Raises ValueError for a map to be
    rendered whose pose is not known.
    """
    images = recording.rendered is not None
    writer.declare(_INFO, "sensor_msgs/CameraInfo")
    writer.declare(*(
        (_IMAGE, "sensor_msgs/Image") if images else (_CENTROIDS, "sensor_msgs/PointCloud2")
    ))
    catalog = StarCatalog.named("hipparcos", limiting_magnitude=recording.limiting_magnitude)
    for i, star_map in enumerate(maps):
        stamp_ns = START_NS + round(i * 1e9 / recording.rate_hz)
        header = writer.header(stamp_ns, recording.frame_id)
        camera = star_map.camera
        if recording.rendered is None:
            cloud = cloud_from_centroids(Centroids(star_map.xy_px), header)
            writer.write(_INFO, info_from_camera(camera, header), stamp_ns)
            writer.write(_CENTROIDS, cloud, stamp_ns)
            continue
        settings = replace(recording.rendered, seed=recording.rendered.seed + i)
        picture = _rendered(star_map, catalog, settings)
        counted = camera.moved(-PIXEL_ORIGINS["center"])
        writer.write(_INFO, info_from_camera(counted, header), stamp_ns)
        encoding = "mono8" if picture.pixels.dtype.itemsize == 1 else "mono16"
        writer.write(_IMAGE, image_from_picture(picture, encoding, header), stamp_ns)


def _rendered(star_map: StarMap, catalog: StarCatalog, settings: RenderSettings) -> Picture:
    if star_map.pose is None:
        raise ValueError(f"{star_map.name} cannot be rendered: its pose is not known")
    return Picture(render(star_map.camera, star_map.pose.rotation, catalog, settings).image)
