"""The attitude against the Earth: `attitude_itrs`, or `imu_enu` for filters of a robot."""

from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import QuaternionStamped, Vector3Stamped
from rclpy.node import Node
from sensor_msgs.msg import Imu, NavSatFix
from std_msgs.msg import Header

from star_tracker.earth.apparent import PRESSURE_RANGE_HPA, TEMPERATURE_RANGE_C, Atmosphere
from star_tracker.earth.attitude import EarthAttitude, Fix, enu_attitude, itrs_attitude
from star_tracker.earth.rotation import (
    POLAR_MOTION_RANGE_ARCSEC,
    UT1_UTC_RANGE_S,
    EarthOrientation,
    load_erfa,
)
from star_tracker.earth.site import (
    HEIGHT_RANGE_M,
    LATITUDE_RANGE_DEG,
    LONGITUDE_RANGE_DEG,
    Site,
)
from star_tracker.geometry.spherical import Floats
from star_tracker.msg_adapters import MessageError
from star_tracker.msg_adapters.attitude import quaternion_from_attitude
from star_tracker.msg_adapters.imu import imu_from_attitude
from star_tracker.msg_adapters.site import site_from_fix
from star_tracker.msg_adapters.stamp import nanoseconds_from_header
from star_tracker.msg_adapters.velocity import velocity_from_vector
from star_tracker.nodes.declaring import parameter
from star_tracker.nodes.identify.transforms import Mounting
from star_tracker.nodes.listening import PUBLISHED, subscribe, subscribe_latched
from star_tracker.solution import Solution

EARTH_FRAMES = ("none", "itrs", "enu")
#: REP-105's name of the Earth-fixed frame.
_EARTH = "earth"
#: Stands for a latitude or longitude that is not told; no place has it.
_NOT_TOLD = -1000.0
_QUEUE_DEPTH = 50
_COMPLAINT_S = 10.0
#: A satellite in a low orbit turns by 0.07 deg/s: its 5" of aberration err by 0.06" in 10 s.
_VELOCITY_AGE_NS = 10 * 10**9


@dataclass(frozen=True)
class EarthParameters:
    """What identify_node is told of the Earth. Raises ValueError for what does not go together."""

    earth_frame: str = parameter(
        "none", "itrs: publish attitude_itrs, Earth-fixed; enu: publish imu_enu, against east, "
        "north, up; none: neither", choices=EARTH_FRAMES, fixed=True,
    )
    latitude_deg: float = parameter(
        _NOT_TOLD, "geodetic latitude of the camera, north positive; -1000 = not told", "deg",
        allowed=(_NOT_TOLD, LATITUDE_RANGE_DEG[1]),
    )
    longitude_deg: float = parameter(
        _NOT_TOLD, "longitude of the camera, east positive; -1000 = not told", "deg",
        allowed=(_NOT_TOLD, LONGITUDE_RANGE_DEG[1]),
    )
    height_m: float = parameter(
        0.0, "height of the camera above the ellipsoid", "m", allowed=HEIGHT_RANGE_M
    )
    use_fix: bool = parameter(
        False, "take the place from fix (NavSatFix), not from parameters", fixed=True
    )
    use_velocity: bool = parameter(
        False, "with earth_frame itrs, correct aberration by the camera's velocity about the "
        "Earth, from velocity (Vector3Stamped, GCRS, m/s)", fixed=True,
    )
    ut1_utc_s: float = parameter(
        0.0, 'UT1 - UTC, from IERS Bulletin A; 0.1 s is 1.5"', "s", allowed=UT1_UTC_RANGE_S
    )
    polar_motion_arcsec: tuple[float, ...] = parameter(
        (0.0, 0.0), "the pole, xp and yp, from IERS Bulletin A", "arcsec",
        allowed=POLAR_MOTION_RANGE_ARCSEC,
    )
    pressure_hpa: float = parameter(
        0.0, "air pressure at the camera, not reduced to sea level; 0 = do not correct refraction",
        "hPa", allowed=PRESSURE_RANGE_HPA,
    )
    temperature_c: float = parameter(
        10.0, "air temperature at the camera", "deg C", allowed=TEMPERATURE_RANGE_C
    )

    def __post_init__(self) -> None:
        if len(self.polar_motion_arcsec) != 2:
            raise ValueError(
                f"parameter polar_motion_arcsec has {len(self.polar_motion_arcsec)} numbers: "
                "give xp and yp"
            )
        told = [name for name in ("latitude_deg", "longitude_deg")
                if getattr(self, name) != _NOT_TOLD]
        if self.earth_frame == "enu" and not self.use_fix and len(told) < 2:
            raise ValueError(
                "parameter earth_frame enu needs a place: set latitude_deg and longitude_deg, "
                "or use_fix"
            )
        if told:
            Site(*(getattr(self, name) if name in told else 0.0
                   for name in ("latitude_deg", "longitude_deg")))

    @property
    def site(self) -> Site:
        """The place that the parameters tell."""
        return Site(self.latitude_deg, self.longitude_deg, self.height_m)

    @property
    def orientation(self) -> EarthOrientation:
        """What they tell of the Earth's rotation."""
        return EarthOrientation(self.ut1_utc_s, *self.polar_motion_arcsec)

    @property
    def air(self) -> Atmosphere:
        """What they tell of the air."""
        return Atmosphere(self.pressure_hpa, self.temperature_c)


class EarthOutput:
    """Publishes each attitude against the Earth, as `earth_frame` says.

    Args:
        node: what publishes, and listens to `fix` and `velocity` where they are wanted.
        parameters: as they are at the start.
        reference_frame: frame_id that a velocity may have too.
        mounting: whose body's attitude is published.

    Raises ValueError where pyerfa is missing.
    """

    def __init__(
        self, node: Node, parameters: EarthParameters, reference_frame: str, mounting: Mounting
    ) -> None:
        try:
            load_erfa()
        except ImportError as error:
            raise ValueError(f"parameter earth_frame {parameters.earth_frame}: {error}") from error
        self._node, self._mounting = node, mounting
        self._inertial = {reference_frame, "gcrs", "icrs"}
        #: Attitudes that could not be told against the Earth.
        self.n_refused = 0
        self._site: Site | None = None
        self._velocity: tuple[int, Floats] | None = None
        itrs = parameters.earth_frame == "itrs"
        self._publisher = node.create_publisher(
            *((QuaternionStamped, "attitude_itrs") if itrs else (Imu, "imu_enu")), _QUEUE_DEPTH,
            qos_overriding_options=PUBLISHED,
        )
        if parameters.use_fix:
            subscribe_latched(node, NavSatFix, "fix", 1, self._on_fix)
        if parameters.use_velocity:
            subscribe(node, Vector3Stamped, "velocity", 1, self._on_velocity)

    def publish(
        self, solution: Solution, camera_header: Header, parameters: EarthParameters
    ) -> None:
        """Publish a solved frame's attitude; the header has its stamp and the camera's frame."""
        mounted = self._mounting.camera_from_body(camera_header.frame_id)
        if mounted is None:
            self.n_refused += 1
            return
        try:
            attitude = self._attitude(solution, camera_header, parameters).of_body(mounted)
        except ValueError as error:
            self.n_refused += 1
            self._node.get_logger().error(
                f"no attitude against the Earth: {error}", throttle_duration_sec=_COMPLAINT_S
            )
            return
        if parameters.earth_frame == "itrs":
            header = Header(stamp=camera_header.stamp, frame_id=_EARTH)
            self._publisher.publish(quaternion_from_attitude(attitude, header))
        else:
            body = self._mounting.body_of(camera_header.frame_id)
            header = Header(stamp=camera_header.stamp, frame_id=body)
            self._publisher.publish(imu_from_attitude(attitude, header))

    def _attitude(
        self, solution: Solution, header: Header, parameters: EarthParameters
    ) -> EarthAttitude:
        """Return the camera's attitude. Raises ValueError with the reason why there is none."""
        fix, stamp_ns = Fix.of_solution(solution), nanoseconds_from_header(header)
        if parameters.earth_frame == "itrs":
            velocity = self._velocity_at(stamp_ns) if parameters.use_velocity else None
            return itrs_attitude(
                fix, stamp_ns, orientation=parameters.orientation, velocity_m_per_s=velocity
            )
        site = self._site if parameters.use_fix else parameters.site
        if site is None:
            raise ValueError("use_fix is true and no usable NavSatFix was received on fix")
        return enu_attitude(
            fix, stamp_ns, site, orientation=parameters.orientation, air=parameters.air
        )

    def _velocity_at(self, stamp_ns: int) -> Floats:
        if self._velocity is None:
            raise ValueError("use_velocity is true and nothing usable was received on velocity")
        told_ns, velocity = self._velocity
        if abs(stamp_ns - told_ns) > _VELOCITY_AGE_NS:
            raise ValueError(
                f"the last velocity is {abs(stamp_ns - told_ns) / 1e9:.1f} s "
                f"{'older' if told_ns < stamp_ns else 'younger'} than the frame: send one at "
                f"least every {_VELOCITY_AGE_NS // 10**9} s"
            )
        return velocity

    def _on_fix(self, message: NavSatFix, _: Any) -> None:
        try:
            self._site = site_from_fix(message)
        except MessageError as error:  # the last place that is known stays
            self._complain(str(error))

    def _on_velocity(self, message: Vector3Stamped, _: Any) -> None:
        try:
            velocity = velocity_from_vector(message, self._inertial)
        except MessageError as error:
            self._complain(str(error))
        else:
            self._velocity = nanoseconds_from_header(message.header), velocity

    def _complain(self, sentence: str) -> None:
        self._node.get_logger().warning(sentence, throttle_duration_sec=_COMPLAINT_S)
